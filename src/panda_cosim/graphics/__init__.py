"""How it looks: the page, videos and plots."""
