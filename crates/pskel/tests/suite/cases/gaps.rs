//! Missing and damaged parts of a log: one policy for all readers.
