"""What findings and errors are called: one module for each front end."""
