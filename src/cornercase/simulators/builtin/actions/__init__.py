"""Actions of the storyboard, such as speed and lane changes, as the builtin simulator runs them."""
