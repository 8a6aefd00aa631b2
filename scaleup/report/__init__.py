"""What is left of a run: results, figures, report, comparison."""
