"""Sequence -> package, as functions from frozen values to frozen values.

`survey` asks the training views what matters; `calibration` finds steps and a ladder for the scene; `plan` lays out
every group (with `levels` and `rank`); `keys` and `states` quantise them, without what `leave_out` can do without;
`representation` makes and checks streams, `tables` the files and tables, with what `error_bounds` promises;
`quality` measures the rungs. `encoder` is these steps in order, `search` repeats it until a target is met, and
`publish.encode` puts the finished package in its place.
"""
