"""What `saflite new` writes: a small working part of each kind, to be changed."""
