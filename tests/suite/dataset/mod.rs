//! Readers: synthetic logs with faults, and real recordings.

mod av2_bad;
mod av2_map;
mod maps;
mod nuplan_bad;
mod nuplan_real;
mod nuscenes;
mod real_log;
