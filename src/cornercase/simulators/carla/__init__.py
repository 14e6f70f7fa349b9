"""CARLA, through its ScenarioRunner."""
