//! Readers: synthetic logs with faults, and real recordings.

mod av2;
mod av2_bad;
mod av2_map;
mod clocks;
mod columns;
mod maps;
mod nuplan;
mod nuplan_bad;
mod nuplan_real;
mod nuscenes;
mod nuscenes_bad;
mod nuscenes_map;
mod oversized;
mod py123d;
mod real_log;
mod sweeps;
mod table_sets;
