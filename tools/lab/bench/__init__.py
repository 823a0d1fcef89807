"""Benchmarks: a case a module."""
