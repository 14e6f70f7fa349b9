"""The page that shows what changed between two versions."""
