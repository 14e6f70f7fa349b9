"""CARLA by its ScenarioRunner."""
