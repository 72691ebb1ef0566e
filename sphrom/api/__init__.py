"""sphrom from Python: studies, reduced models at any parameters, and artifacts as xarray.

    study = sphrom.Study("cases/taylor_green_demo.yaml", resolution=50)
    study.run(until="operators")
    result = study.model("fast-m5", reynolds=137).run()

`import sphrom` offers all names below, and loads nothing before one of them is used. Arrays have
the axes snapshot, point, component or mode last; units are SI. What the command line refuses is
refused here in the same words, as an error of `sphrom.errors`.
"""

from sphrom.api.model import Model
from sphrom.api.result import Result, Sensitivities
from sphrom.api.study import Study, open
from sphrom.artifacts.records.fit import FittedHistory
from sphrom.fit.fit import Estimate, Fit
from sphrom.online.error_estimates import ErrorEstimate

__all__ = [
    "ErrorEstimate",
    "Estimate",
    "Fit",
    "FittedHistory",
    "Model",
    "Result",
    "Sensitivities",
    "Study",
    "open",
]
