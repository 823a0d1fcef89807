"""Long runs in which much fails or much time goes by."""
