"""The quantiser steps and levels that one scene asks for, from small trial encodes.

`subject` is the group that is tried and `sample` what is coded of it; `solve` finds the steps, `ladder` the levels,
tiers and key qualities; `calibrate` does both, and `cache` keeps what it found.
"""
