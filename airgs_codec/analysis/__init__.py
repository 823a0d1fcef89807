"""What pictures say about a scene: groups, usage, sensitivity, importance."""
