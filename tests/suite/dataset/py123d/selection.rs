//! Selection of logs among several.

use point_skeleton::dataset::py123d::{FORMAT, expand};
use point_skeleton::dataset::{DatasetError, LogLocator};
use pskel_testing::py123d_log::{LOG, SPLIT, SYNC, TinyPy123d, assert_message};

/// Folder of logs: the same name in two splits, and another log at another place.
fn logs() -> TinyPy123d {
    let mut made = TinyPy123d::new();
    let write = |made: &TinyPy123d, folder: &str| {
        let folder = made.root().join("logs").join(folder);
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::copy(made.path(SYNC), folder.join("sync.arrow")).unwrap();
    };
    write(&made, &format!("made_val/{LOG}"));
    made.edit(SYNC, |table| table.about(|about| about["location"] = "elsewhere".into()));
    write(&made, "made_val/other");
    made.edit(SYNC, |table| table.about(|about| about["location"] = "nowhere".into()));
    // Neither is a log.
    std::fs::create_dir_all(made.root().join("logs/made_val/empty")).unwrap();
    std::fs::write(made.root().join("logs/made_val/file"), "").unwrap();
    made
}

/// Returns `SPLIT/LOG` of the selected logs below a folder of the root.
fn selected(
    made: &TinyPy123d,
    below: &str,
    split: Option<&str>,
    log: Option<&str>,
) -> Result<Vec<String>, DatasetError> {
    let [version, scene] = [split, log].map(|text| text.map(str::to_owned));
    let path = if below.is_empty() { made.root().to_owned() } else { made.root().join(below) };
    let found = expand(&LogLocator { version, scene, ..LogLocator::new(&FORMAT, path) })?;
    let shown = |locator: &LogLocator| {
        assert_eq!((&locator.version, &locator.scene), (&None, &None));
        locator.path.strip_prefix(made.root().join("logs")).unwrap().to_str().unwrap().to_owned()
    };
    Ok(found.iter().map(shown).collect())
}

#[test]
fn logs_are_selected() {
    let made = logs();
    let (train, val, other) =
        (format!("{SPLIT}/{LOG}"), format!("made_val/{LOG}"), "made_val/other".to_owned());
    let found = |below: &str, split, log| selected(&made, below, split, log).unwrap();
    for below in ["", "logs"] {
        for all in [None, Some("*")] {
            assert_eq!(found(below, None, all), [train.clone(), val.clone(), other.clone()]);
            assert_eq!(found(below, Some("made_val"), all), [val.clone(), other.clone()]);
        }
        assert_eq!(found(below, None, Some(LOG)), [train.clone(), val.clone()]);
        assert_eq!(found(below, Some(SPLIT), Some(LOG)), std::slice::from_ref(&train));
        assert_eq!(found(below, None, Some("other")), std::slice::from_ref(&other));
        assert_eq!(found(below, None, Some("nowhere")), [train.clone(), val.clone()]);
        assert_eq!(found(below, Some("made_val"), Some("nowhere")), std::slice::from_ref(&val));
        assert_eq!(found(below, None, Some("elsewhere")), std::slice::from_ref(&other));
    }
    assert_eq!(found("logs/made_val", None, None), [val.clone(), other]);
    assert_eq!(found(&format!("logs/{val}"), None, None), std::slice::from_ref(&val));
    assert_eq!(found(&format!("logs/{val}"), Some("made_val"), Some(LOG)), [val]);
}

#[test]
fn wrong_selections_are_named() {
    let made = logs();
    let refused = |below: &str, split, log, parts: &[&str]| {
        let ending =
            if below.is_empty() { made.root().file_name().unwrap().to_str().unwrap() } else { below };
        assert_message(&selected(&made, below, split, log).unwrap_err(), parts, ending);
    };
    refused("", Some("train"), None, &["expected @SPLIT to name one of made_train, made_val, found @train"]);
    refused(
        "",
        None,
        Some("none"),
        &["expected #SCENE to name one of 2026.01.02.made, 2026.01.02.made, other, found none"],
    );
    refused("", Some(SPLIT), Some("other"), &["to name one of 2026.01.02.made, found other"]);
    refused("", None, Some("../made_val/other"), &["found ../made_val/other"]);
    refused(
        "sensors",
        None,
        None,
        &["expected a log (a folder with sync.arrow) or a folder of logs", "found neither"],
    );
    refused("missing", None, None, &["cannot read"]);
    refused("logs/made_val/file", None, None, &["cannot read"]);
    refused(&format!("logs/{SPLIT}/{LOG}"), Some("made_val"), None, &["one of made_train, found @made_val"]);
    // A log that cannot be compared with a place.
    std::fs::write(made.root().join("logs/made_val/other/sync.arrow"), "damaged").unwrap();
    assert_message(
        &selected(&made, "", None, Some("nowhere")).unwrap_err(),
        &["found 7 bytes"],
        "made_val/other/sync.arrow",
    );
    assert_eq!(selected(&made, "", Some(SPLIT), Some("nowhere")).unwrap().len(), 1);
}

#[test]
fn one_log_must_be_selected() {
    let made = logs();
    let open = |split: Option<&str>, log: Option<&str>| {
        let [version, scene] = [split, log].map(|text| text.map(str::to_owned));
        let locator = LogLocator { path: made.root().into(), version, scene, ..made.locator() };
        point_skeleton::dataset::open(&locator).map(|reader| reader.recording().name.clone())
    };
    let names = "made_train/2026.01.02.made, made_val/2026.01.02.made";
    let error = open(None, None).unwrap_err().to_string();
    assert!(error.contains(&format!("{names}, made_val/other, found none")), "{error}");
    let error = open(None, Some(LOG)).unwrap_err().to_string();
    assert!(error.contains(&format!("{names}, found 2026.01.02.made")), "{error}");
    assert_eq!(open(Some(SPLIT), Some(LOG)).unwrap(), LOG);
    assert_eq!(open(Some(SPLIT), None).unwrap(), LOG);
}
