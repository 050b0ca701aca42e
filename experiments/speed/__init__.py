"""Yardsticks and rows of the report on speed against error.

The yardsticks (`pairs`, `contact`, `lbfgs`, `fire`) are what others would run: plain
numba loops on one thread, and jax-md as it comes. The rows measure jaxgrow against
them; `experiments/baselines.py` checks the yardsticks, `experiments/speed_error.py`
runs the rows.
"""
