//! Resources that run out: memory, threads, drivers.
