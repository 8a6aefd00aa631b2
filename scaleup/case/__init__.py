"""The case: a configuration that was composed, judged and resolved."""
