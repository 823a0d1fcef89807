"""What numbers do: error against run time (`work_precision`), and scenes at their ends (`extremes`)."""
