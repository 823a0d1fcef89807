"""Sequence -> package, as functions from frozen values to frozen values.

`prepare` names frames, orders rows and splits groups; `pipeline` declares the steps by which a group is encoded, which
`batch` drives as jobs and `live` at once. `survey` asks views what matters; `calibrate` finds steps and a ladder on a
`sample`; `plan` lays out every group; `keys` and `states` quantise them, without what `omit` can do without;
`representation` makes and checks streams, `tables` the files and tables; `measure` measures the rungs and `verify`
believes it. `search` repeats it all until a target is met, and `publish.encode` puts the finished package in its place.
"""
