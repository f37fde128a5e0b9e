"""What every long-running process needs: its configuration, its signs of life, its end."""
