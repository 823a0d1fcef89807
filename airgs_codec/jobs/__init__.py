"""Work that is cut into jobs: each is done once, wherever it is done, and never lost when something else dies.

`digest` names a job by the content of everything that it reads; `store` keeps results under these names; `job` is what
a worker does with one; `engines` and `dask_engine` say where workers are; `work` runs jobs and gives their results;
`report` draws who did what when.
"""
