"""SUMO as a simulator, whose models can drive vehicles."""
