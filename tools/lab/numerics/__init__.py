"""What numbers do: error against run time (`work_precision`), and stiff and extreme cases (`stiff`)."""
