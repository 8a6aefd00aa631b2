"""What a user states, in units: material, operation, loading."""
