"""Files in and out: test cases, logs, campaigns, schemas."""
