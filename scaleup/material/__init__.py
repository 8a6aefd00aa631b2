"""What a powder is, from tables measured in the laboratory."""
