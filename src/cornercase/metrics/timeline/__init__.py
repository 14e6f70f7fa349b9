"""Events between the ego and another entity, and the effect that earlier braking would have had."""
