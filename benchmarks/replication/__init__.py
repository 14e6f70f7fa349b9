"""The paper's statements, and the reconstructions of its scenarios for which each is tested."""
