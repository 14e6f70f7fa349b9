"""Compiled kernels: they run one scenario until its storyboard has to be evaluated in Python.

Index names in all of them: `n` scenario, `e` entity, `j` action, `row` track. `state`, `flags` and `numbers` are the
scenario's float, bool and int tables; their rows are the constants of `world/_state_layout.py`, their columns entities.
"""
