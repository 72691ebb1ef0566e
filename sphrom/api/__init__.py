"""sphrom from Python: studies, reduced models at any parameters, and artifacts as xarray.

    study = sphrom.Study("cases/taylor_green_demo.yaml", resolution=50)
    study.run(until="operators")
    result = study.model("fast-m5", reynolds=137).run()

`import sphrom` provides all names below, and loads each when it is first used. Arrays have the axes
snapshot, point, and last component or mode; units are SI. Invalid input raises the errors of
`sphrom.errors`, with the messages of the command line.
"""
