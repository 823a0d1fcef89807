"""Which way is up: what cues are worth on models and scenes whose answer is known."""
