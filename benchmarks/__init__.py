"""Benchmarks: `python -m benchmarks` lists the cases."""
