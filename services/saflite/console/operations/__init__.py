"""What commands share: flying, judging, replaying, running, swapping scorers."""
