"""Test cards: one printed A4 page for each kept scenario or given id, for people who drive on a proving ground."""
