"""Programs that write committed data and pages of the tests: run as `python -m tests.makers.NAME`."""
