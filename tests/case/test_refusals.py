"""What a case is refused for: one line, with file, line, key and what is allowed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

VORTEX = "name: small\nscene:\n  kind: taylor-green\n"
LID = "name: box\nscene:\n  kind: lid-driven-cavity\n"
FAST = "{name: fast, evaluation: operators, n_modes: 3}"
BASES = {
    "vortex": VORTEX,
    "lid": LID,
    "cavity": "name: open\nscene:\n  kind: open-cavity\n",
    "three snapshots": f"{VORTEX}time: {{step: 1.0e-3, final_time: 0.02}}\n",
    "two training runs": f"{VORTEX}parameters: {{train: {{reynolds: [100, 200]}}}}\n",
    "two models": f"{VORTEX}rom: [{{name: slow}}, {{name: fast, evaluation: operators}}]\n",
    "local bases": f"{VORTEX}parameters: {{train: {{reynolds: [100, 200, 300]}}}}\n"
    "basis: {subsets: {low: {reynolds: [100, 200]}, high: {reynolds: [200, 300]}}}\n"
    "rom: [{name: fast, evaluation: operators, basis: local, parameters: [150]}]\n",
    "draws": f"{LID}parameters: {{train: {{reynolds: [50, 200], lid: [0.5, 1]}}}}\n"
    "rom: [{name: fast, evaluation: operators}]\n",
    "nothing": "",
    "fit": f"{LID}discretization: {{resolution: 10}}\ntime: {{final_time: 0.5}}\n"
    "snapshots: {every: 5}\nparameters: {train: {reynolds: [50, 200], lid: [0.5, 1.0]}}\n"
    f"rom: [{{name: slow, n_modes: 3}}, {FAST}]\n",
    "training": f"{LID}discretization: {{resolution: 20}}\n"
    f"rom: [{{name: slow, n_modes: 2}}, {FAST}]\n",
    "constants": """
name: x
discretization: {resolution: 40}
scene:
  kind: custom
  box: {upper: [2, 2], periodic: [x]}
  solids: {disc: {circle: {centre: [1, 1], radius: 0.3}}}
  constants: {U: 1.0, g: 2.0, omega: 3.0, k: 1.5}
  walls: {top: {velocity: ["U*(1 + 0.1*cos(pi*x))", 0]}, disc: {rotation: 0.5}}
  body_force: ["(1 + g*sin(k*y))*cos(omega*t)", 0]
  initial: {u: "sin(k*y)/omega"}
""",
    "cylinder": """
name: x
discretization: {resolution: 60}
scene:
  kind: custom
  box: {upper: [6, 4], periodic: [x]}
  solids: {cylinder: {circle: {centre: [3, 2], radius: 1}}}
  reference_length: 2.0
""",
    "open": """
name: x
time: {final_time: 20}
discretization: {resolution: 40}
scene:
  kind: custom
  box: {lower: [-1, 0], upper: [4, 1], periodic: [x]}
  solids: {square: {rectangle: {lower: [1.2, 0.4], upper: [1.6, 0.8]}}}
  constants: {k: 1.0}
  resistance: "0*k"
  porous: {mat: {rectangle: {lower: [2, 0], upper: [2.5, 1]}, permeability: 0.01}}
  inflow: {strip: {from: -1, to: 0.5}, velocity: ["6*y*(1 - y)", 0]}
  reference_length: 1.0
""",
    "tank": """
name: x
discretization: {resolution: 50}
scene:
  kind: custom
  fluid: {level: 0.5}
  solids: {wall: {rectangle: {lower: [0.6, 0], upper: [0.8, 1]}}}
rom: []
""",
    "sloshing": """
name: x
discretization: {resolution: 10}
scene:
  kind: custom
  slip: free
  body_force: ["0.01*sin(t)", 0]
  fluid: {level: 0.5, gravity: 1.0}
rom: [{name: fast, evaluation: operators, n_modes: 3}]
""",
    "space": """
name: x
discretization: {resolution: 24}
scene:
  kind: custom
  box: {lower: [0, 0, 0], upper: [2, 1, 1], periodic: [x]}
""",
}
"""The cases of the groups of `refusals.txt`."""


def refusals() -> Iterator[tuple[str, str, str]]:
    """Yield a case, the text that is added to it, and the words that refuse it."""
    group = ""
    table = Path(__file__).with_name("refusals.txt").read_text(encoding="utf-8")
    for row in filter(None, table.splitlines()[1:]):
        if row.startswith("[") and row.endswith("]") and "=>" not in row:
            group = row[1:-1]
        else:
            given, words = row.split("  =>  ")
            yield BASES[group], re.sub(r"(?<!\\)\\n", "\n", given), words


@pytest.mark.parametrize(("base", "given", "words"), tuple(refusals()))
def test_refusals(refusal, base: str, given: str, words: str) -> None:
    text, *changes = given.split("--set ")
    line, *_ = refusal(f"{text.strip()}\n", *map(str.strip, changes), base=base)
    for each in words.split(" ... "):
        assert each in line
    if not changes and base:
        place = re.match(r"case\.yaml:(\d+): ", line)
        assert place is not None
        assert 0 < int(place[1]) - base.count("\n") <= text.count("\n") + 1
