"""Images, H.264 in MP4, films, and how alike pictures are. Nothing here knows Gaussians."""
