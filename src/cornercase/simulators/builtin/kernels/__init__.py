"""Compiled functions (kernels) that run a scenario until Python has to evaluate its storyboard.

Names of indices in all kernels: `n` scenario, `e` entity, `j` action, `row` track. `state`, `flags` and `numbers` are
tables of the floats, booleans and integers of a scenario. The constants in `world/_state_layout.py` name the rows of
these tables; the columns are entities.
"""
