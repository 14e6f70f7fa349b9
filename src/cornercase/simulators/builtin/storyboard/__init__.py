"""The storyboard: events, triggers and conditions."""
