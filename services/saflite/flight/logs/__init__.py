"""Flight logs of real autopilots as traces."""
