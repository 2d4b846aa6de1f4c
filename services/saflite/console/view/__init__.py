"""What people see: lines and tables, the live screen, the report."""
