//! Peer commands end with the simulation.

use std::path::Path;
use std::time::{Duration, Instant};

use pskel_sim::peer::PeerAddress;
use pskel_sim::{EgoPolicy, PlannerSpec, SimOptions, Simulation};
use pskel_testing::stubborn_peer::{group_of, planner, started};
use pskel_testing::winding_road;

/// Maximum time that processes may outlive the program.
const MAX_TIME: Duration = Duration::from_secs(2);

/// A stopped planner leaves no guard process behind, neither running nor as a zombie.
#[test]
fn a_stopped_planner_leaves_no_process() {
    let log = winding_road::log(6);
    let folder = tempfile::tempdir().unwrap();
    let address = PeerAddress::Command(planner(folder.path()));
    let ego = EgoPolicy::External(PlannerSpec { address, timeout_s: 5.0 });
    let options = SimOptions { steps: 60, warmup_frames: 3, ego, ..SimOptions::default() };
    assert!(Simulation::new(&winding_road::scenario(&log), options).is_err(), "it does not answer");
    let pids = started(folder.path());
    for pid in pids {
        let start = Instant::now();
        while group_of(pid).is_some() {
            assert!(start.elapsed() < MAX_TIME, "{pid} goes on");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
    // The guard's process id is also its group's. A zombie would still have an entry.
    let guard = std::fs::read_to_string(folder.path().join("group")).unwrap();
    assert!(!Path::new("/proc").join(guard.trim()).exists(), "guard {guard}");
}
