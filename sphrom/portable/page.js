// The page of a model: controls, picture, curves and table. model.js has the numbers.

const PLAYED = 8, N_SCALED = 12, N_SAMPLED = 1000;
// Duration of a run on the page [s]; snapshots and places from which a colour scale is determined.
const SHOWN = [0.005, 0.995];  // quantiles at the ends of a colour scale, as in all figures
const model = decoded(JSON.parse(document.getElementById("model").textContent));
const COLOURS = JSON.parse(document.getElementById("colours").textContent);
const {nx, ny, lower, upper, inside: {values: inside}, slices} = model.fields, {periodic, solids} = model.geometry;
// A box in space is shown by three slices side by side.
const fluid = slices ? slices.map(([l, r, b, t]) => [[[l, b], [r, b], [r, t], [l, t]]]) : model.geometry.fluid;
const QUANTITIES = {"speed": "m/s", "pressure": "Pa", "x-velocity": "m/s", "y-velocity": "m/s",
  ...(slices ? {"z-velocity": "m/s"} : {"vorticity": "1/s"})};
const {start, interval, n_snapshots: nSnapshots} = model.times, end = start + interval * (nSnapshots - 1);
const size = upper.map((x, i) => x - lower[i]), indices = range(nx * ny);
const $ = id => document.getElementById(id);
const state = {time: start, quantity: "speed", playing: false, parameters: {}};

// Return an element; texts are shown as they are, never read as markup.
function make(tag, attributes = {}, ...content) {
  const svg = ["svg", "path", "line", "title"].includes(tag);
  const made = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  Object.entries(attributes).forEach(([name, value]) => made.setAttribute(name, value));
  made.append(...content);
  return made;
}

function short(value, digits = 3) {
  if (!Number.isFinite(value)) return "unknown";
  const size = Math.abs(value);
  return size > 0 && (size < 1e-3 || size >= 1e5) ? value.toExponential(digits - 2) : `${+value.toPrecision(digits)}`;
}

// ---- fields on the grid of the picture

// Return the derivative of a field along an axis: central, but one-sided beside walls.
function derivative(values, axis) {
  const n = [nx, ny][axis], stride = [1, nx][axis], spacing = size[axis] / n;
  return Float32Array.from(indices, k => {
    const i = axis ? Math.floor(k / nx) : k % nx;
    const [before, after] = [-1, 1].map(step => {
      const within = i + step >= 0 && i + step < n;
      const other = k + (within ? step : step - step * n) * stride;
      return (within || periodic[axis]) && inside[other] ? other : k;
    });
    const gaps = (before !== k) + (after !== k);
    return gaps ? (values[after] - values[before]) / (gaps * spacing) : 0;
  });
}

// Arrays of columns of a field; columns that are zero are missing. Those of the pressure are mixed.
const fields = range(slices ? 4 : 3).map(field => {
  const {modes, scale, field: ofField, column} = model.fields, columns = [];
  ofField.forEach((other, row) => {
    if (other !== field) return;
    const values = modes.values.subarray(row * nx * ny, (row + 1) * nx * ny);
    columns[column[row]] = Float32Array.from(values, x => x * scale.values[row]);
  });
  return columns;
});
const velocity = fields.slice(0, -1), mixed = fields.at(-1), [u, v, w] = velocity;
const pressure = rowsOf(model.fields.mix).map(factors => onGrid(mixed, factors, nx * ny));
const vorticity = slices ? [] : v.map((column, i) => {
  const across = derivative(u[i], 1);
  return derivative(column, 0).map((x, k) => x - across[k]);
});
const columnsOf = {"speed": velocity, "pressure": [pressure], "x-velocity": [u], "y-velocity": [v],
  ...(slices ? {"z-velocity": [w]} : {"vorticity": [vorticity]})};
const fluidPlaces = indices.filter(k => inside[k]);
const sampledPlaces = fluidPlaces.filter((_, i) => i % Math.ceil(fluidPlaces.length / N_SAMPLED) === 0);
const sampled = Object.fromEntries(Object.entries(columnsOf).map(([name, parts]) =>
  [name, parts.map(columns => columns.map(column => sampledPlaces.map(k => column[k])))]));

// The nearest place in the fluid of every place, so that pictures go on below the outlines of solids.
const source = new Int32Array(nx * ny).fill(-1);
fluidPlaces.forEach(k => { source[k] = k; });
for (let edge = fluidPlaces; edge.length;) {
  edge = edge.flatMap(k => [k % nx > 0 && k - 1, k % nx < nx - 1 && k + 1, k - nx, k + nx].filter(other => {
    if (source[other] !== -1 || other === false) return false;
    source[other] = source[k];
    return true;
  }));
}

// Return a field's values, from the columns of its parts.
function fieldOf(parts, at, n = nx * ny) {
  const offset = state.quantity === "pressure" ? model.sound_speed ** 2 * solution.mean : 0;
  const [first, ...others] = parts.map(columns => onGrid(columns, at, n, offset));
  return others.length ? first.map((x, k) => Math.hypot(x, ...others.map(other => other[k]))) : first;
}

// Return the state at a time, linear between snapshots.
function stateAt(time) {
  const {states, width} = solution, place = Math.min(Math.max(0, (time - start) / interval), nSnapshots - 1);
  const before = Math.min(Math.floor(place + 1e-9), nSnapshots - 2), share = place - before;
  return range(width).map(i => (1 - share) * states[before * width + i] + share * states[(before + 1) * width + i]);
}

// Return the name and range of the colours of the chosen quantity, the same for a whole run.
function scaleOf() {
  const values = range(N_SCALED).flatMap(i =>
    Array.from(fieldOf(sampled[state.quantity], stateAt(start + (end - start) * i / (N_SCALED - 1)), sampledPlaces.length)));
  const known = values.filter(Number.isFinite).sort((a, b) => a - b);
  const [low, high] = SHOWN.map(q => known.length ? known[Math.round(q * (known.length - 1))] : q);
  if (!(low < 0 && high > 0)) return ["plain", low, high > low ? high : low + 1];
  const largest = Math.max(-low, high);
  return ["signed", -largest, largest];
}

const tables = Object.fromEntries(Object.entries(COLOURS).map(([name, stops]) => {
  const rgb = stops.map(stop => [1, 3, 5].map(i => parseInt(stop.slice(i, i + 2), 16)));
  return [name, range(256).map(i => {
    const place = i / 255 * (stops.length - 1), k = Math.min(stops.length - 2, Math.floor(place));
    return rgb[k].map((x, channel) => Math.round(x + (place - k) * (rgb[k + 1][channel] - x)));
  })];
}));
const canvas = $("field"), picture = canvas.getContext("2d"), image = picture.createImageData(nx, ny);
let solution, errors, scale, failure;

function drawPicture() {
  const [name, low, high] = scale, table = tables[name];
  const field = fieldOf(columnsOf[state.quantity], stateAt(state.time));
  indices.forEach(k => {
    const share = (field[source[k]] - low) / (high - low), x = k % nx, y = ny - 1 - (k - x) / nx;
    const [red, green, blue] = table[Math.max(0, Math.min(255, Math.round(255 * share)))] || [128, 128, 128];
    image.data.set([red, green, blue, 255], 4 * (y * nx + x));
  });
  picture.putImageData(image, 0, 0);
  const found = fluidPlaces.map(k => field[k]).filter(Number.isFinite);
  return [found.reduce((a, b) => Math.min(a, b), Infinity), found.reduce((a, b) => Math.max(a, b), -Infinity)];
}

// ---- curves

const outside = () => model.parameters.filter(p => !(state.parameters[p.name] >= p.low && state.parameters[p.name] <= p.high));
const plots = [];

function addPlot(label, unit, box) {
  const band = make("path", {class: "band"}), line = make("path", {class: "line"}), now = make("line", {class: "now", y1: 0, y2: 100});
  const svg = make("svg", {viewBox: "0 0 100 100", preserveAspectRatio: "none", "aria-hidden": "true"}, band, line, now);
  const high = make("span"), low = make("span"), value = make("output");
  box.append(make("figure", {}, make("figcaption", {}, `${label}${unit === "1" ? "" : ` [${unit}]`} `, value),
    make("div", {class: "plot"}, make("div", {class: "ends"}, high, low), svg)));
  const cells = range(4).map(() => make("td"));
  $("values").append(make("tr", {}, make("th", {scope: "row"}, `${label}${unit === "1" ? "" : ` [${unit}]`}`), ...cells));
  plots.push({band, line, now, high, low, value, cells, values: [], errors: null});
}

function shapePlot(plot, values, known) {
  Object.assign(plot, {values, errors: known});
  const ends = [-1, 1].map(side => values.map((x, s) => x + side * (known && Number.isFinite(known[s]) ? known[s] : 0)));
  const finite = ends.flat().filter(Number.isFinite);
  let low = finite.reduce((a, b) => Math.min(a, b), Infinity), high = finite.reduce((a, b) => Math.max(a, b), -Infinity);
  if (!(high - low > 1e-9 * Math.max(Math.abs(low), Math.abs(high)))) [low, high] = finite.length ? [low - 1e-9, low + 1e-9] : [0, 1];
  const points = row => row.map((x, s) => Number.isFinite(x) && `${(100 * s / (nSnapshots - 1)).toFixed(2)},${(100 * (high - x) / (high - low)).toFixed(2)}`).filter(Boolean);
  const path = list => list.length ? `M${list.join("L")}` : "";
  plot.line.setAttribute("d", path(points(values)));
  plot.band.setAttribute("d", known ? path([...points(ends[0]), ...points(ends[1]).reverse()]) : "");
  plot.high.textContent = short(high);
  plot.low.textContent = short(low);
  plot.range = [values.filter(Number.isFinite)].map(x => [Math.min(...x), Math.max(...x)])[0];
}

function showValues() {
  const snapshot = Math.round((state.time - start) / interval), place = 100 * (state.time - start) / (end - start);
  for (const plot of plots) {
    ["x1", "x2"].forEach(name => plot.now.setAttribute(name, place));
    const value = short(plot.values[snapshot]), error = plot.errors ? short(plot.errors[snapshot], 2) : "unknown";
    plot.value.textContent = error === "unknown" ? value : `${value} ± ${error}`;
    [value, error, ...plot.range.map(x => short(x))].forEach((text, i) => { plot.cells[i].textContent = text; });
  }
}

// ---- the page

// Run the model at the chosen parameters, and show everything.
function solve() {
  solution = run(model, state.parameters);
  errors = estimated(model, solution);
  failure = Number.isNaN(solution.divergedAt) ? "" : `The run is unstable after t = ${short(solution.divergedAt)} s.`;
  const values = measured(model, solution);
  const fields = errors ? [0, 1].map(f => [errors.sizes, errors.errors].map(list => list.map(x => x[f]))) : [];
  [...fields, ...values.map((each, k) => [each, errors && errors.outputs[k]])].forEach((pair, i) => shapePlot(plots[i], ...pair));
  document.body.classList.toggle("outside", Boolean(outside().length || errors && errors.outside));
  rescale();
}

function rescale() {
  scale = scaleOf();
  const [name, low, high] = scale, unit = QUANTITIES[state.quantity];
  $("scale").style.background = `linear-gradient(to right, ${COLOURS[name].join(", ")})`;
  $("low").textContent = `${short(low)} ${unit}`;
  $("high").textContent = `${short(high)} ${unit}`;
  show();
}

function show() {
  const [low, high] = drawPicture(), unit = QUANTITIES[state.quantity];
  $("time").value = state.time;
  $("now").textContent = `t = ${short(state.time)} s`;
  showValues();
  if (state.playing) return;
  const asked = model.parameters.map(p => `${p.name} = ${short(state.parameters[p.name], 4)}`).join(", ");
  const seen = high >= low ? `${state.quantity} from ${short(low)} to ${short(high)} ${unit}` : "no flow";
  const text = `${asked}, t = ${short(state.time)} s: ${seen}.`;
  canvas.setAttribute("aria-label", text);
  const doubts = outside().map(p => `${p.name} was trained from ${short(p.low, 4)} to ${short(p.high, 4)}`);
  if (!doubts.length && errors && errors.outside) doubts.push("these values are not between trained ones");
  $("warning").textContent = [failure, doubts.length ? `Outside of the trained range: ${doubts.join("; ")}.` : ""].join(" ").trim();
  $("state").textContent = text;
  const [velocity, ofPressure] = errors ? errors.percent.map(x => short(x, 2)) : [];
  $("error").textContent = !errors ? "This model does not estimate its errors." :
    `Estimated error over the whole field and run: ${velocity} % in velocity, ${ofPressure} % in pressure${doubts.length ? ", extrapolated" : ""}.`;
}

// Add the controls of a parameter: a slider that goes beyond the trained range, and a number.
function addParameter({name, unit, low, high, ...parameter}, k) {
  const beyond = high > low ? (high - low) / 2 : Math.abs(low) / 2 || 1;
  const step = 10 ** Math.floor(Math.log10(beyond / 10));
  const bottom = low > 0 ? Math.max(low / 2, low - beyond) : low - beyond;
  const [least, most, value] = [bottom, high + beyond, parameter.default].map(x => +(Math.round(x / step) * step).toPrecision(12));
  const limits = {min: least, max: most, step, value};
  const slider = make("input", {type: "range", id: `p${k}`, ...limits});
  const number = make("input", {type: "number", "aria-label": `${name}, as a number`, ...limits, step: "any"});
  const share = x => (x - least) / (most - least);
  const trained = make("i", {title: "trained range"});
  trained.style.cssText = `--from: ${share(low)}; --to: ${share(high)}`;
  const label = `${name}${unit === "1" ? "" : ` [${unit}]`}`;
  $("parameters").append(make("div", {class: "parameter"}, make("label", {for: `p${k}`}, label),
    make("span", {class: "track"}, slider, trained), number));
  state.parameters[name] = value;
  const change = (from, to) => () => {
    const value = from.valueAsNumber;
    if (!(value >= least && value <= most)) return;
    to.value = value;
    state.parameters[name] = value;
    solve();
  };
  slider.addEventListener("input", change(slider, number));
  number.addEventListener("input", change(number, slider));
  number.addEventListener("change", () => { number.value = state.parameters[name]; });
}

function tick(before) {
  requestAnimationFrame(now => {
    if (!state.playing) return;
    state.time += (now - before) / 1000 / PLAYED * (end - start);
    if (state.time > end) state.time = start;
    show();
    tick(now);
  });
}

function play(playing) {
  state.playing = playing;
  $("play").textContent = playing ? "Pause" : "Play";
  if (playing) tick(performance.now());
  else show();
}

function addOutlines() {
  const [left, bottom] = lower, [right, top] = upper, frame = $("outlines");
  const path = polygons => polygons.flat().map(ring => `M${ring.map(([x, y]) => `${x},${-y}`).join("L")}Z`).join("");
  const sides = [[left, bottom, left, top], [right, bottom, right, top], [left, bottom, right, bottom], [left, top, right, top]];
  const box = [[[left, bottom], [right, bottom], [right, top], [left, top]]];
  frame.setAttribute("viewBox", `${left} ${-top} ${size[0]} ${size[1]}`);
  frame.append(make("path", {class: "solid", "fill-rule": "evenodd", d: path([box, ...fluid])}));
  solids.forEach(({name, polygons}) => frame.append(make("path", {class: "wall", d: path(polygons)}, make("title", {}, name))));
  sides.filter((_, i) => !slices && !periodic[Math.floor(i / 2)]).forEach(([x1, y1, x2, y2]) =>
    frame.append(make("line", {class: "wall side", x1, y1: -y1, x2, y2: -y2})));
  const depth = model.geometry.upper[2], ends = {left, right: slices ? depth : right, bottom, top: slices ? depth : top};
  if (slices) ["rightward", "upward"].forEach((name, i) => { $(name).textContent = `${"xy"[i]}, then z [m]`; });
  Object.entries(ends).forEach(([side, value]) => { $(side).textContent = short(value); });
  Object.assign(canvas, {width: nx, height: ny});
  $("picture").style.cssText = `--ratio: ${size[0] / size[1]}`;
}

addOutlines();
model.parameters.forEach(addParameter);
if (model.errors) {
  addPlot("velocity, root mean square", "m/s", $("curves"));
  addPlot("pressure, root mean square about its mean", "Pa", $("curves"));
}
model.outputs.forEach(({name, at, unit}) =>
  addPlot(at ? `${name} at (${at.map(x => short(x)).join(", ")}) m` : name, unit, $(plots.length < 8 ? "curves" : "more")));
$("about").textContent = `From t = ${short(start)} s to ${short(end)} s; bands are estimated errors.`;
$("further").hidden = plots.length <= 8;
Object.keys(QUANTITIES).forEach(name => $("quantity").append(make("option", {}, name)));
$("quantity").addEventListener("change", event => { state.quantity = event.target.value; rescale(); });
Object.assign($("time"), {min: start, max: end, step: interval});
$("time").addEventListener("input", event => { state.time = event.target.valueAsNumber; play(false); });
$("play").addEventListener("click", () => play(!state.playing));
state.time = start + interval * Math.round((nSnapshots - 1) / 2);
solve();
// A page around this one may give it the height that it needs.
const tell = () => parent.postMessage({height: document.documentElement.offsetHeight}, "*");
if (parent !== window) {
  document.body.classList.add("embedded");
  tell();
  new ResizeObserver(tell).observe(document.body);
}
