"""Pictures and video files: reading, writing, H.264, comparing."""
