"use strict";
// A fast model from its document: runs, measurements, fields and estimated errors. The page
// docs/portable.md has the document and the equations. Nothing here knows the page of the model.

const KINDS = {f8: Float64Array, f4: Float32Array, i2: Int16Array, u1: Uint8Array};
const VISCOSITY = "kinematic viscosity";
const INSIDE = 1e-6, NEARNESS = 1e-4, ROUNDING = 1e-12;  // as sphrom.reduction.correction

// Return a part of a document with decoded arrays {shape, values}.
function decoded(part) {
  if (part === null || typeof part !== "object") return part;
  if (Array.isArray(part)) return part.map(decoded);
  if (typeof part.data === "string") {
    const bytes = Uint8Array.from(atob(part.data), c => c.charCodeAt(0));
    return {shape: part.shape, values: new KINDS[part.type](bytes.buffer)};
  }
  return Object.fromEntries(Object.entries(part).map(([key, value]) => [key, decoded(value)]));
}

const range = n => Array.from({length: n}, (_, i) => i);
const sum = (items, of) => items.reduce((total, item, i) => total + of(item, i), 0);
const distance = (a, b) => Math.hypot(...a.map((x, i) => x - b[i]));
const rowsOf = ({shape, values}) =>
  range(shape[0]).map(i => Array.from(values.subarray(i * shape[1], (i + 1) * shape[1])));
const nearest = distances => {
  const rounded = distances.map(d => Math.round(d * 1e9));
  return rounded.indexOf(Math.min(...rounded));
};

// Return an array's sum over its first axis, with a factor each.
function combined(array, factors) {
  const shape = array.shape.slice(1), values = new Float64Array(array.values.length / factors.length);
  factors.forEach((factor, k) => {
    for (let i = 0; i < values.length; i++) values[i] += factor * array.values[k * values.length + i];
  });
  return {shape, values};
}

// Return the monomials of n coordinates from a place in an array on, up to the second degree.
function monomials(x, at, n) {
  const terms = new Float64Array((n + 1) * (n + 2) / 2);
  let next = 1 + n;
  terms[0] = 1;
  for (let i = 0; i < n; i++) {
    terms[1 + i] = x[at + i];
    for (let j = i; j < n; j++) terms[next++] = x[at + i] * x[at + j];
  }
  return terms;
}

// Return rows of a polynomial (n_powers, n_rows, n_monomials) of an amplitude and monomials.
function polynomial({shape: [nPowers, nRows, nTerms], values}, amplitude, terms) {
  const out = new Float64Array(nRows);
  let factor = 1, at = 0;
  for (let power = 0; power < nPowers; power++, factor *= amplitude) {
    for (let row = 0; row < nRows; row++) {
      let total = 0;
      for (let k = 0; k < nTerms; k++) total += values[at++] * terms[k];
      out[row] += factor * total;
    }
  }
  return out;
}

// Add a vector times a matrix (n, m), from an offset of its values on, to a row of an array.
function addProduct(x, {shape, values}, at, out, start = 0) {
  const width = shape[shape.length - 1];
  at *= x.length * width;
  for (let i = 0; i < x.length; i++) {
    for (let j = 0; j < width; j++) out[start + j] += x[i] * values[at++];
  }
}

// Add what training runs teach, interpolated at a place, to an array (n_snapshots, width).
function addKriged(kriging, place, out, width) {
  if (kriging === null) return;
  const {targets, lengths, values} = kriging, [, nSnapshots, nEntries] = values.shape;
  rowsOf(kriging.places).forEach((trained, k) => {
    const weights = lengths.values.map(length => Math.exp(-distance(trained, place) / length));
    for (let s = 0, at = k * nSnapshots * nEntries; s < nSnapshots; s++) {
      for (let j = 0; j < nEntries; j++) out[s * width + targets[j]] += weights[j] * values.values[at++];
    }
  });
}

// Return the solution of a linear system, by elimination with pivots.
function solved(matrix, right) {
  const rows = matrix.map((row, i) => [...row, right[i]]), n = rows.length;
  for (let i = 0; i < n; i++) {
    const pivot = range(n - i).reduce((best, k) => Math.abs(rows[i + k][i]) > Math.abs(rows[best][i]) ? i + k : best, i);
    [rows[i], rows[pivot]] = [rows[pivot], rows[i]];
    for (let k = 0; k < n; k++) {
      if (k === i) continue;
      const factor = rows[k][i] / rows[i][i];
      for (let j = i; j <= n; j++) rows[k][j] -= factor * rows[i][j];
    }
  }
  return rows.map((row, i) => row[n] / row[i]);
}

// Return the nonnegative least-squares solution (Lawson and Hanson 1974).
function nonnegative(matrix, right) {
  const columns = matrix[0].map((_, j) => matrix.map(row => row[j])), used = new Set();
  const dot = (a, b) => sum(a, (x, i) => x * b[i]), x = columns.map(() => 0);
  for (let round = 0; round < 3 * columns.length; round++) {
    const rest = right.map((b, i) => b - dot(matrix[i], x));
    const slopes = columns.map((column, j) => used.has(j) ? -Infinity : dot(column, rest));
    if (!(Math.max(...slopes) > 1e-14)) break;
    used.add(slopes.indexOf(Math.max(...slopes)));
    for (;;) {
      const chosen = [...used];
      const z = solved(chosen.map(i => chosen.map(j => dot(columns[i], columns[j]))), chosen.map(i => dot(columns[i], right)));
      const share = Math.min(1, ...chosen.map((j, k) => z[k] <= 0 ? x[j] / (x[j] - z[k]) : 1));
      chosen.forEach((j, k) => { x[j] += share * (z[k] - x[j]); });
      if (share === 1 && z.every(value => value > 0)) break;
      chosen.forEach(j => { if (x[j] <= 1e-15) { x[j] = 0; used.delete(j); } });
    }
  }
  return x;
}

// Return the weights of training points at a place, and its distance from their hull.
function interpolationWeights(places, place) {
  const distances = places.map(trained => distance(trained, place)), largest = Math.max(...distances);
  const closest = distances.indexOf(Math.min(...distances));
  if (largest === 0 || distances[closest] <= ROUNDING * largest) return [places.map((_, k) => +(k === closest)), 0];
  const offsets = places.map(trained => trained.map((x, i) => (x - place[i]) / largest));
  const rows = [...place.map((_, i) => offsets.map(offset => offset[i])), places.map(() => 1),
    distances.map(d => NEARNESS * (d / largest) ** 2)];
  const found = nonnegative(rows, rows.map((_, i) => +(i === place.length))), total = sum(found, w => w);
  const weights = found.map(w => w / total);
  const missed = Math.hypot(...place.map((_, i) => sum(weights, (w, k) => w * offsets[k][i])));
  return [weights, missed > INSIDE ? missed * largest : 0];
}

// Run a model at parameter values by name.
function run(model, parameters) {
  const {n_integrated: n, n_modes: nModes, n_own: nOwn, times: {start, interval, n_snapshots: nSnapshots}} = model;
  const product = names => names.reduce((found, name) =>
    found * (name === VISCOSITY ? model.viscosity / parameters.reynolds : parameters[name]), 1);
  const factors = model.products.map(product);
  const at = array => combined(array, factors);
  const place = model.parameters.map(p => p.logarithm ? Math.log(parameters[p.name]) : parameters[p.name] / p.scale);
  const scaled = model.parameters.map(p => parameters[p.name] / p.scale);
  const first = nearest(rowsOf(model.starts.places).map(other => distance(other, scaled)));
  const step = model.runs.steps[nearest(rowsOf(model.runs.places).map(other => distance(other, place)))];
  const {snapshots_per_step: perStep, steps_per_snapshot: perSnapshot} = step;
  const table = model.driving === null ? null : at(model.driving.amplitude).values;
  // The amplitude after a number of intervals, which is a whole number of the table's.
  const amplitude = intervals => table === null ? 0 : table[Math.round(intervals * model.driving.per_snapshot)];
  const rates = at(model.dynamics), [, , nTerms] = rates.shape;
  for (let i = 0; i < n; i++) {
    for (let j = 0; j < n; j++) rates.values[i * nTerms + 1 + j] -= step.linear.values[i * n + j];
  }
  const rest = (x, from, when) => polynomial(rates, amplitude(when), monomials(x, from, n));
  const largest = model.largest_norm * Math.max(1, ...scaled.map(Math.abs));
  const coordinates = new Float64Array(nSnapshots * nModes);
  let state = model.starts.coordinates.values.slice(first * n, (first + 1) * n), divergedAt = NaN;
  coordinates.set(state);
  const length = perStep / perSnapshot, nSteps = Math.ceil((nSnapshots - 1) / perStep) * perSnapshot;
  for (let k = 0; k < nSteps && isNaN(divergedAt); k++) {
    const when = k * length, stages = new Float64Array(3 * n), reached = new Float64Array(perStep * n);
    const r0 = rest(state, 0, when);
    addProduct(state, step.stages, 0, stages);
    addProduct(r0, step.stages, 1, stages);
    const r1 = rest(stages, 0, when + length / 2);
    addProduct(r1, step.links, 0, stages, n);
    const r2 = rest(stages, n, when + length / 2);
    addProduct(r2, step.links, 1, stages, 2 * n);
    const r3 = rest(stages, 2 * n, when + length);
    [state, r0, r1.map((r, i) => (r + r2[i]) / 2), r3].forEach((x, i) => addProduct(x, step.ends, i, reached));
    state = reached.slice((perStep - 1) * n);
    if (!(Math.hypot(...state) <= largest)) divergedAt = start + when * interval;
    const from = (k + 1) * perStep / perSnapshot - perStep + 1;  // snapshot, if it is whole
    for (let j = 0; j < perStep && Number.isInteger(from) && from + j < nSnapshots; j++) {
      coordinates.set(reached.subarray(j * n, (j + 1) * n), (from + j) * nModes);
    }
  }
  if (!isNaN(divergedAt)) coordinates.fill(NaN, (Math.floor((divergedAt - start) / interval) + 1) * nModes);
  addKriged(model.correction, place, coordinates, nModes);
  const mean = model.starts.mean.values[first], width = nModes + nOwn;
  const terms = range(nSnapshots).map(s => monomials(coordinates, s * nModes, nModes));
  const states = new Float64Array(nSnapshots * width);
  const own = nOwn ? at(model.pressure.coefficients) : null;
  terms.forEach((each, s) => {
    states.set(coordinates.subarray(s * nModes, (s + 1) * nModes), s * width);
    if (own !== null) states.set(polynomial(own, amplitude(s), each), s * width + nModes);
  });
  if (own !== null) {
    const added = new Float64Array(nSnapshots * nOwn);
    addKriged(model.pressure.correction, place, added, nOwn);
    added.forEach((x, i) => { states[Math.floor(i / nOwn) * width + nModes + i % nOwn] += x; });
  }
  return {at, place, coordinates, terms, states, width, mean, amplitude, divergedAt,
    time: range(nSnapshots).map(s => start + s * interval)};
}

// Return the values (n_snapshots,) of all measurements of a run, in the order of the outputs.
function measured(model, {at, place, terms, states, width, mean, amplitude, time}) {
  const found = rowsOf(model.linear).map(row => time.map((_, s) => {
    let value = row[0] + mean * row[1];
    for (let i = 0; i < width; i++) value += row[2 + i] * states[s * width + i];
    return value;
  }));
  for (const force of model.forces) {
    const coefficients = at(force.coefficients), uniform = at(force.uniform).values, [, n] = coefficients.shape;
    const added = new Float64Array(time.length * n), nOwn = force.own === null ? 0 : force.own.shape[1];
    addKriged(force.correction, place, added, n);
    const loads = time.map((_, s) => polynomial(coefficients, amplitude(s), terms[s]).map((load, i) => {
      for (let k = 0; k < nOwn; k++) load += force.own.values[i * nOwn + k] * states[(s + 1) * width - nOwn + k];
      return load + mean * (uniform[i] + amplitude(s) * uniform[n + i]) + added[s * n + i];
    }));
    found.push(...range(n).map(i => loads.map(each => each[i])));
  }
  return found;
}

// Return the estimated errors of a run; null if the model has no estimates.
//   percent: of velocity and pressure, over the whole run [%];
//   errors, sizes: root mean squares of errors and fields (n_snapshots, 2) [m/s, Pa];
//   outputs: of measurements (n_outputs, n_snapshots); outside: of the trained parameters.
function estimated(model, {at, place, coordinates, terms, states, width, amplitude}) {
  const known = model.errors;
  if (known === null) return null;
  const places = rowsOf(known.places), [weights, missed] = interpolationWeights(places, place);
  const nModes = model.n_modes, nSnapshots = terms.length, fields = [0, 1];
  const apart = Math.max(...places.flatMap(a => places.map(b => distance(a, b))));
  const constants = fields.map(f => {
    const logarithms = places.map((_, k) => Math.log(known.constants.values[2 * k + f]));
    const spread = Math.max(...logarithms) - Math.min(...logarithms);
    return Math.exp(sum(weights, (w, k) => w * logarithms[k]) + (apart > 0 ? Math.min(1, missed / apart) : 0) * spread);
  });
  const parts = [known.residual, known.closure].filter(part => part !== null).map(at);
  const residual = terms.map((each, s) =>
    Math.hypot(...parts.flatMap(part => Array.from(polynomial(part, amplitude(s), each)))));
  const decay = known.decay_rate, interval = model.times.interval, remains = Math.exp(-decay * interval);
  const middle = (1 - remains) / (decay * interval), older = (middle - remains) / decay, newer = (1 - middle) / decay;
  const expected = combined(known.expected, weights).values, width2 = known.gram.shape[1];
  let accumulated = 0;
  const errors = [], sizes = [];
  for (let s = 0; s < nSnapshots; s++) {
    if (s > 0) accumulated = remains * accumulated + older * residual[s - 1] + newer * residual[s];
    const change = Math.hypot(...range(nModes).map(i => coordinates[s * nModes + i] - expected[s * nModes + i]));
    errors.push(fields.map(f => known.units.values[f] * Math.hypot(constants[f] * accumulated, known.shares.values[f] * change)));
    const x = range(width2).map(i => i < width ? states[s * width + i] : 1);
    sizes.push(fields.map(f => known.units.values[f] * Math.sqrt(Math.max(0,
      sum(x, (a, i) => a * sum(x, (b, j) => b * known.gram.values[(f * width2 + i) * width2 + j]))))));
  }
  const ratio = f => Math.sqrt(sum(errors, e => e[f] ** 2) / sum(sizes, e => e[f] ** 2));
  const {shape: [, nOutputs], values: noise} = known.noise;
  const outputs = model.outputs.map(({field}, k) => errors.map((error, s) =>
    Math.sqrt(noise[s * nOutputs + k] + known.output_shares.values[k] * error[field] ** 2)));
  return {percent: fields.map(f => 100 * ratio(f)), errors, sizes, outputs, outside: missed > 0};
}

// Return the values of a state at n places, from the columns of a field; columns may be missing.
function onGrid(columns, state, n, offset = 0) {
  const out = new Float64Array(n).fill(offset);
  columns.forEach((column, i) => {
    const factor = i === 0 ? 1 : state[i - 1];
    for (let k = 0; k < n; k++) out[k] += factor * column[k];
  });
  return out;
}
