"""What tests share: scenes, manifests, pictures of scenes, and where the data lies."""
