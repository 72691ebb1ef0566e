"""sphrom from Python: studies, reduced models at any parameters, and artifacts as xarray.

    study = sphrom.Study("cases/taylor_green_demo.yaml", resolution=50)
    study.run(until="operators")
    result = study.model("fast-m5", reynolds=137).run()

`import sphrom` offers all names below, and loads nothing before one of them is used. Arrays have
the axes snapshot, point, component or mode last; units are SI. What the command line refuses is
refused here in the same words, as an error of `sphrom.errors`.
"""

from sphrom.api.model import Model as Model
from sphrom.api.result import Result as Result
from sphrom.api.result import Sensitivities as Sensitivities
from sphrom.api.study import Study as Study
from sphrom.api.study import open as open
from sphrom.artifacts.records.fit import FittedHistory as FittedHistory
from sphrom.fit.fit import Estimate as Estimate
from sphrom.fit.fit import Fit as Fit
from sphrom.online.error_estimates import ErrorEstimate as ErrorEstimate
