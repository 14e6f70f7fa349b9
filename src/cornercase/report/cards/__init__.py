"""Test cards: one printed A4 page for each kept scenario, for people who drive the scenario on a proving ground."""
