"""Packages over HTTP: their files, pages that play them, the application, the server and its link."""
