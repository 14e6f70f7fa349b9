"""Page of a comparison between two versions."""
