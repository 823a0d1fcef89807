"""Work that is done elsewhere: `work` calls a function by an executor and stores results, `executors` has executors."""
