"""A trained model as a Functional Mock-up Unit (FMI 2.0), from C sources.

`fmu.c` runs the model of `sphrom.portable.document`, whose arrays are written into a header. Where
there is a C compiler, the unit also has a binary. `docs/portable.md` says how it is used.
"""

from __future__ import annotations

import io
import platform
import re
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from sphrom.arrays import Array
from sphrom.errors import CaseError
from sphrom.models.contract import Model
from sphrom.portable.document import document
from sphrom.reduction.reduced_operators import stability_limits

SOURCE = Path(__file__).with_name("fmu.c")
COMPILER = "cc"
FLAGS = ("-O2", "-std=c99", "-shared", "-fPIC", "-fvisibility=hidden")
PLATFORMS = {("Linux", "x86_64"): "binaries/linux64/{}.so"}
"""The place of the binary, by system and machine."""
BLOCK = 100_000
"""References: parameters, the input and its switch, outputs, states and rates, BLOCK each."""
STEP_SHARE = 0.125
"""Steps in co-simulation, relative to the largest stable ones around training states."""
SECONDS = 300
"""Time that compilation may take [s]."""
MOST_REASON = 500
"""Largest number of characters of the compiler's messages in a warning."""


def content(model: Model[Any]) -> bytes:
    """Return a model as the bytes of an FMU.

    Where the compiler fails, it warns and leaves the binary out.

    Raises CaseError as `document` does, and if two variables of the unit would have one name.
    """
    found = document(model)
    name = "sphrom_" + re.sub(r"\W", "_", found["case"], flags=re.ASCII)
    header = _header(found)
    source = SOURCE.read_bytes()
    files = {
        "modelDescription.xml": _description(found, name).encode(),
        "sources/model.h": header,
        "sources/fmu.c": source,
    }
    if (place := binary()) is not None:
        try:
            files[place.format(name)] = _compiled(source, header)
        except subprocess.SubprocessError as error:
            reason = str(getattr(error, "stderr", None) or error).strip()[-MOST_REASON:]
            model.workspace.context.report.warn(
                f"export: the unit of {model.section.name} has sources alone, without a binary, "
                f"because the C compiler failed: {reason}"
            )
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, data in files.items():
            archive.writestr(zipfile.ZipInfo(path), data, zipfile.ZIP_DEFLATED)
    return memory.getvalue()


def binary() -> str | None:
    """Return the place of the binary; None without a compiler, or on another kind of machine."""
    found = shutil.which(COMPILER) is not None
    return PLATFORMS.get((platform.system(), platform.machine())) if found else None


def _compiled(source: bytes, header: bytes) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "fmu.c").write_bytes(source)
        Path(folder, "model.h").write_bytes(header)
        command = [COMPILER, *FLAGS, "fmu.c", "-o", "fmu.so", "-lm"]
        subprocess.run(
            command, cwd=folder, capture_output=True, text=True, check=True, timeout=SECONDS
        )
        return Path(folder, "fmu.so").read_bytes()


def _header(found: Mapping[str, Any]) -> bytes:
    """Return the C header with the arrays of a document."""
    parameters = found["parameters"]
    forces = found["forces"]
    errors = found["errors"]
    times = found["times"]
    n_products = len(found["products"])
    n_modes, n_own = found["n_modes"], found["n_own"]
    width = 1 + n_modes + n_modes * (n_modes + 1) // 2
    powers = found["dynamics"].shape[1]
    rows = [force["coefficients"].shape[2] for force in forces]

    def stacked(parts: Sequence[Array]) -> Array:
        """Return polynomials (n_products, n_powers, n_rows, width) with their rows together."""
        out = np.zeros((n_products, powers, sum(part.shape[2] for part in parts), width))
        first = 0
        for part in parts:
            _, n_powers, n_rows, used = part.shape
            out[:, :n_powers, first : first + n_rows, :used] = part
            first += n_rows
        return out

    residuals = [] if errors is None else [errors["residual"]]
    if errors is not None and errors["closure"] is not None:
        residuals.append(errors["closure"])
    residual = stacked(residuals)
    driving = found["driving"]
    amplitude = np.zeros((n_products, 4)) if driving is None else driving["amplitude"]
    own = [
        np.zeros((n, n_own)) if f["own"] is None else f["own"]
        for n, f in zip(rows, forces, strict=True)
    ]
    uniform = [force["uniform"] for force in forces]
    pressure = found["pressure"]
    entries = _entries(found, rows)
    names = [each["name"] for each in parameters] + ["kinematic viscosity"]
    n_outputs = len(found["outputs"])
    limits = [
        stability_limits(np.linalg.eigvals(s["linear"])).min() for s in found["runs"]["steps"]
    ]
    numbers = {
        "N": found["n_integrated"],
        "M": found["dynamics"].shape[3],
        "N_MODES": n_modes,
        "M_ALL": width,
        "N_OWN": n_own,
        "N_ROWS": sum(rows),
        "N_LINEAR": len(found["linear"]),
        "N_OUTPUTS": n_outputs,
        "N_POWERS": powers,
        "N_PRODUCTS": n_products,
        "N_PARAMETERS": len(parameters),
        "N_SNAPSHOTS": times["n_snapshots"],
        "N_AMPLITUDES": amplitude.shape[1],
        "N_STARTS": len(found["starts"]["mean"]),
        "N_ENTRIES": len(entries),
        "N_RESIDUALS": residual.shape[2],
        "N_TRAINED": 1 if errors is None else len(errors["places"]),
        "HAS_ERRORS": int(errors is not None),
        "START_TIME": times["start"],
        "INTERVAL": times["interval"],
        "AMPLITUDE_INTERVAL": times["interval"]
        / (1 if driving is None else driving["per_snapshot"]),
        "VISCOSITY": found["viscosity"],
        "LARGEST": 10.0 * found["largest_norm"],
        "STEP": STEP_SHARE * float(min(limits)),
        "DECAY": 0.0 if errors is None else errors["decay_rate"],
        "BLOCK": BLOCK,
    }
    of_errors = {} if errors is None else errors
    noise = of_errors.get("noise", np.zeros((times["n_snapshots"], n_outputs)))
    arrays = {
        "DEFAULTS": [each["default"] for each in parameters],
        "SCALES": [each["scale"] for each in parameters],
        "LOGARITHMS": [each["logarithm"] for each in parameters],
        "PRODUCTS": [[name in product for name in names] for product in found["products"]],
        "DYNAMICS": found["dynamics"],
        "PRESSURE": stacked([] if pressure is None else [pressure["coefficients"]]),
        "LOADS": stacked([force["coefficients"] for force in forces]),
        "RESIDUAL": residual,
        "UNIFORM": np.concatenate(uniform, axis=2) if uniform else [],
        "OWN": np.concatenate(own) if own else [],
        "AMPLITUDE": amplitude,
        "START_PLACES": found["starts"]["places"],
        "STARTS": found["starts"]["coordinates"],
        "MEANS": found["starts"]["mean"],
        "LINEAR": found["linear"],
        "TRAINED": of_errors.get("places", np.zeros(len(parameters))),
        "CONSTANTS": of_errors.get("constants", np.ones(2)),
        "EXPECTED": of_errors.get("expected", []),
        "SHARES": of_errors.get("shares", np.zeros(2)),
        "UNITS": of_errors.get("units", np.zeros(2)),
        # An unknown error is negative.
        "NOISE": np.nan_to_num(noise, nan=-1.0),
        "OUTPUT_SHARES": np.nan_to_num(of_errors.get("output_shares", [])),
        "FIELDS": [each["field"] for each in found["outputs"]],
        "ENTRY_LENGTHS": [length for _, length, _, _ in entries],
    }
    lines = [f'#define GUID "{found["digest"]}"']
    lines += [f"#define {name} {value!r}" for name, value in numbers.items()]
    lines += [_array(f"{name}[]", values) for name, values in arrays.items()]
    for k, (_, _, places, values) in enumerate(entries):
        lines += [_array(f"PLACES_{k}[]", places), _array(f"VALUES_{k}[]", values)]
    every = range(len(entries))
    lines += [
        _list("double *const ENTRY_PLACES", (f"PLACES_{k}" for k in every)),
        _list("double *const ENTRY_VALUES", (f"VALUES_{k}" for k in every)),
        _list("int ENTRY_TARGETS", (str(target) for target, _, _, _ in entries)),
        _list("int ENTRY_RUNS", (str(len(places)) for _, _, places, _ in entries)),
    ]
    return "\n".join([*lines, ""]).encode()


def _entries(
    found: Mapping[str, Any], rows: Sequence[int]
) -> list[tuple[int, float, Array, Array]]:
    """Return target, correlation length, places and values of each corrected number.

    The numbers are the coordinates, those of separate pressure modes, and the loads, whose `rows`
    belong to one force each.
    """
    n_modes = found["n_modes"]
    firsts = np.cumsum([n_modes + found["n_own"], *rows]).tolist()
    corrections = [(0, found["correction"])]
    if found["pressure"] is not None:
        corrections.append((n_modes, found["pressure"]["correction"]))
    for first, force in zip(firsts[:-1], found["forces"], strict=True):
        corrections.append((first, force["correction"]))
    return [
        (first + target, known["lengths"][k], known["places"], known["values"][..., k])
        for first, known in corrections
        if known is not None
        for k, target in enumerate(known["targets"])
    ]


def _array(name: str, values: Any) -> str:
    flat = np.ravel(np.asarray(values, dtype=float)).tolist()
    return _list(f"double {name.removesuffix('[]')}", map(repr, flat))


def _list(name: str, values: Iterable[str]) -> str:
    # C has no empty arrays.
    return f"static const {name}[] = {{{','.join(values) or '0'}}};"


def _description(found: Mapping[str, Any], name: str) -> str:
    """Return the description of the unit's variables. Raises CaseError if two have one name."""
    variables = list[str]()
    labels = set[str]()
    groups: dict[str, list[int]] = {"outputs": [], "states": [], "rates": []}
    n_integrated = found["n_integrated"]

    def add(block: int, number: int, label: str, kind: str, about: str, **real: Any) -> None:
        if label in labels:
            raise CaseError(
                f"export: two variables of the unit would be called {label}; rename a constant, "
                "parameter or measurement"
            )
        labels.add(label)
        values = "".join(f" {key}={quoteattr(str(value))}" for key, value in real.items())
        variables.append(
            f'<ScalarVariable name={quoteattr(label)} valueReference="{block * BLOCK + number}" '
            f"{kind} description={quoteattr(about)}><Real{values}/></ScalarVariable>"
        )

    fixed = 'causality="parameter" variability="fixed"'
    calculated = 'variability="continuous" initial="calculated"'
    for k, each in enumerate(found["parameters"]):
        about = f"trained from {each['low']:g} to {each['high']:g}"
        add(0, k, each["name"], fixed, about, start=repr(each["default"]))
    if found["driving"] is not None:
        about = "amplitude of the driving if own_driving is 0; errors are then unknown"
        add(1, 0, "driving", 'causality="input" variability="continuous"', about, start=0.0)
        about = "1: the driving has the history of the case; 0: that of the input"
        add(1, 1, "own_driving", fixed, about, start=1.0)
    outputs = [(each["name"], each["unit"], each["measure"]) for each in found["outputs"]]
    unknown = "estimated root mean square error; -1 where it is unknown"
    outputs += [(f"error_{label}", unit, unknown) for label, unit, _ in outputs]
    outputs += [("error_velocity", "m/s", unknown), ("error_pressure", "Pa", unknown)]
    about = (
        "1 if the run is outside of the training range, where errors are extrapolated, or if "
        "errors are unknown"
    )
    outputs += [("outside", "1", about)]
    for k, (label, unit, about) in enumerate(outputs):
        groups["outputs"].append(len(variables) + 1)
        add(2, k, label, f'causality="output" {calculated}', about, unit=unit)
    states = [f"coordinate_{i}" for i in range(n_integrated)] + ["accumulated_residual"]
    for k, label in enumerate(states):
        groups["states"].append(len(variables) + 1)
        add(3, k, label, f'causality="local" {calculated}', "state")
    for k, label in enumerate(states):
        groups["rates"].append(len(variables) + 1)
        derivative = groups["states"][k]
        add(4, k, f"der({label})", f'causality="local" {calculated}', "", derivative=derivative)

    def unknowns(*names: str) -> str:
        return "".join(f'<Unknown index="{i}"/>' for each in names for i in groups[each])

    sources = '<SourceFiles><File name="fmu.c"/></SourceFiles>'
    units = "".join(f"<Unit name={quoteattr(u)}/>" for u in sorted({u for _, u, _ in outputs}))
    times = found["times"]
    end = times["start"] + times["interval"] * (times["n_snapshots"] - 1)
    identifier = f'modelIdentifier="{name}" canGetAndSetFMUstate="true"'
    identifier += ' canSerializeFMUstate="true"'
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<fmiModelDescription fmiVersion="2.0" modelName={quoteattr(found["case"])} '
        f'guid="{found["digest"]}" generationTool="sphrom {found["sphrom"]}" '
        'numberOfEventIndicators="0">\n'
        f"<ModelExchange {identifier}>{sources}</ModelExchange>\n"
        f'<CoSimulation {identifier} canHandleVariableCommunicationStepSize="true">{sources}'
        f"</CoSimulation>\n<UnitDefinitions>{units}</UnitDefinitions>\n"
        f'<DefaultExperiment startTime="{times["start"]!r}" stopTime="{end!r}" '
        f'stepSize="{times["interval"]!r}"/>\n'
        f"<ModelVariables>\n{chr(10).join(variables)}\n</ModelVariables>\n"
        f"<ModelStructure><Outputs>{unknowns('outputs')}</Outputs>"
        f"<Derivatives>{unknowns('rates')}</Derivatives>"
        f"<InitialUnknowns>{unknowns('outputs', 'states', 'rates')}</InitialUnknowns>"
        "</ModelStructure>\n</fmiModelDescription>\n"
    )
