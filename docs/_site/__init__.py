"""What the site's pages are made with, besides their text."""
