"""Test cards: a page of A4 for each kept scenario, for the people who drive it on a proving ground."""
