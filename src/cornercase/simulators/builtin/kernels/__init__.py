"""Compiled kernels, which run a scenario until its storyboard has to be evaluated in Python.

Index names in all kernels: `n` scenario, `e` entity, `j` action, `row` track. `state`, `flags` and `numbers` are the
tables of floats, booleans and integers of a scenario. Their rows are the constants of `world/_state_layout.py`, their
columns are entities.
"""
