//! A whole series: reading, lighting and writing at once.
