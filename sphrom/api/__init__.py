"""sphrom from Python: studies, reduced models at any parameters, and artifacts as xarray.

    study = sphrom.Study("cases/taylor_green_demo.yaml", resolution=50)
    study.run(until="operators")
    result = study.model("fast-m5", reynolds=137).run()

`import sphrom` provides all names below, and loads each when it is first used. Arrays have the axes
snapshot, point, and last component or mode; units are SI. Invalid input raises the errors of
`sphrom.errors`, with the messages of the command line.
"""

from sphrom.api.model import Model as Model
from sphrom.api.result import Result as Result
from sphrom.api.result import Sensitivities as Sensitivities
from sphrom.api.study import Study as Study
from sphrom.api.study import load as load
from sphrom.api.study import open as open
from sphrom.artifacts.records.fit import FittedHistory as FittedHistory
from sphrom.fit.fit import Estimate as Estimate
from sphrom.fit.fit import Fit as Fit
from sphrom.models.points.error_estimates import ErrorEstimate as ErrorEstimate
