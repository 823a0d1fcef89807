"""Images, H.264 in MP4, films, and how similar pictures are. Nothing here knows Gaussians."""
