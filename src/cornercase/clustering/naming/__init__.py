"""Names of clusters: predicates that hold for their scenarios."""
