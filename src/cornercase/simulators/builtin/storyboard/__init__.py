"""What happens when: events, triggers and conditions."""
