"""The sections of the page, each the HTML of what it shows."""
