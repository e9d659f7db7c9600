//! Files of the page, which are part of the program.

use pskel_sim::report::{BASE_CSS, PLOTS_JS};

/// Page.
pub(super) const INDEX: &str = include_str!("../page/index.html");

const CSS: &str = "text/css; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";

/// Name, type and content of a file in `src/page`.
macro_rules! file {
    ($name:literal, $kind:expr) => {
        ($name, $kind, include_str!(concat!("../page/", $name)))
    };
}

/// Name, type and content of each file.
const FILES: &[(&str, &str, &str)] = &[
    file!("birdseye.js", JS),
    file!("connection.js", JS),
    file!("controls.js", JS),
    file!("drive.css", CSS),
    file!("edits.js", JS),
    file!("generator.js", JS),
    file!("inspector.js", JS),
    file!("keys.js", JS),
    file!("main.js", JS),
    file!("packet.js", JS),
    file!("selftest.js", JS),
    file!("status.js", JS),
    file!("store.js", JS),
    file!("timeline.js", JS),
    file!("traces.js", JS),
    file!("view.js", JS),
    file!("widgets.js", JS),
];

/// Returns type and content of a file; `None` if the page has no such file.
pub(super) fn find(name: &str) -> Option<(&'static str, &'static str)> {
    let shared = [("base.css", CSS, BASE_CSS), ("plots.js", JS, PLOTS_JS)];
    let mut all = FILES.iter().chain(&shared);
    all.find(|(known, ..)| *known == name).map(|(_, kind, text)| (*kind, *text))
}
