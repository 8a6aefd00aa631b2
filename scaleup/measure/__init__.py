"""What is measured on a blend: intensity, samples."""
