"""Cost of flights and replays on this machine, measured by ``make bench``.

`loop` compares the harness with JSBSim's bare loop, `batch` the batch engine with both. Absolute
figures depend on the machine; ratios of loops that take turns can be compared.
"""
