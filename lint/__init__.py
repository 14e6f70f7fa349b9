"""Rules of the house that no other linter knows. ``python -m lint`` lists what breaks them."""
