"""The benchmark of the field: public data sets, frozen gaps, every method, one table."""
