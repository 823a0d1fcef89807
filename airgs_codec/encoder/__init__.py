"""Sequence -> package, as functions from frozen values to frozen values.

`order` looks at all frames and puts rows in order; `decide` chooses a `plan`: `views`, groups, and the steps and levels
that `steps` finds on a `sample`, and `target` the quality. `group` is the fold by it: `survey` asks views what matters,
`layout` lays out a group, `keyframes` and `deltas` quantise it, without what `omit` can do without; `streams` makes and
checks H.264, `tables` files and tables. `measure` measures the rungs once; `publish` puts the finished package in its
place, `live` one that grows.
"""
