//! A planner that never answers and ignores termination signals, with a child and a grandchild.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Returns a command that neither reads nor answers nor ends, with a child and a grandchild; all ignore
/// termination signals. Each writes its process id to a file.
pub fn planner(folder: &Path) -> String {
    let at = |name: &str| folder.join(name).display().to_string();
    let sleep =
        |name: &str| format!("echo $$ > {0}.new; mv {0}.new {0}; while :; do sleep 1; done", at(name));
    let script = |name: &str, lines: String| {
        let path = folder.join(name);
        std::fs::write(&path, format!("trap '' HUP TERM INT\n{lines}\n")).unwrap();
        path.display().to_string()
    };
    let grandchild = script("grandchild.sh", sleep("grandchild"));
    let child = script("child.sh", format!("sh {grandchild} &\n{}", sleep("child")));
    let group = format!("cut -d' ' -f5 /proc/$$/stat > {}", at("group"));
    let command = script("command.sh", format!("{group}\nsh {child} &\n{}", sleep("command")));
    format!("sh {command}")
}

/// Returns the process ids of the planner's processes, once all have started.
pub fn started(folder: &Path) -> Vec<u32> {
    let files: Vec<PathBuf> = ["command", "child", "grandchild"].map(|name| folder.join(name)).into();
    let start = Instant::now();
    while !files.iter().all(|file| file.exists()) {
        assert!(start.elapsed() < Duration::from_secs(60), "the planner starts");
        std::thread::sleep(Duration::from_millis(10));
    }
    files.iter().map(|file| std::fs::read_to_string(file).unwrap().trim().parse().unwrap()).collect()
}

/// Returns the group of a process; `None` if it has ended, even as a zombie.
pub fn group_of(pid: u32) -> Option<u32> {
    let about = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let (_, rest) = about.rsplit_once(')')?;
    let mut fields = rest.split_whitespace();
    let state = fields.next()?;
    let group = fields.nth(1)?.parse().ok()?;
    (state != "Z" && state != "X").then_some(group)
}
