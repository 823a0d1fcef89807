"""Work that is cut into jobs: each is done once, wherever it is done, and never lost when something else dies.

`job` names a job by the content of everything that it reads and by its code, and is what a worker does with it; stores
(`places.results`) have results under these names; `engines` and `dask_engine` say where workers are; `work` runs jobs
and gives their results.
"""
