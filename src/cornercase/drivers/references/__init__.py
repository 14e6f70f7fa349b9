"""Reference drivers of regulations."""
