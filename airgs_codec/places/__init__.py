"""Where bytes lie: folders, memory, HTTP and buckets in one way, written whole or not at all, and stored results."""
