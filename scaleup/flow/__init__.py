"""The flow: obtained from a model or the store, checked, closed."""
