"""CARLA as a simulator, run by its ScenarioRunner."""
