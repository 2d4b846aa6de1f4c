"""What is to be done, who may do it, under which lease, and whether what comes back fits. Pure."""
