"""MAVLink, client and server side."""
