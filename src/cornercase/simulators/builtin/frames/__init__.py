"""Compiled frames: what happens to one scenario between two happenings of its storyboard."""
