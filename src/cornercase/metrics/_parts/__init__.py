"""What several metrics are made of: boxes, tracks, who follows whom, compiled code."""
