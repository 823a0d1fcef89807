"""What people look at after a session or a study: pages, plots, films."""
