"""A viewer over a network: traces, links, policies, the session and what came of it."""
