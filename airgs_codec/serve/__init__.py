"""Packages over HTTP: their files, answers to requests, a shaped link, the server."""
