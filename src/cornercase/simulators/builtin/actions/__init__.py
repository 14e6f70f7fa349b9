"""Actions of the storyboard."""
