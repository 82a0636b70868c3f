//! From data values to optics: classification and what may be skipped.
