"""Measurements of speed and memory, side by side with other tools: `python -m benchmarks`."""
