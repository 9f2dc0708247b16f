"""Random problems: rigs and processes, records and hidden effects of any kind, place, rate, unit, size and length."""
