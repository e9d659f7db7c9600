//! Messages of the page and of the server.

use serde::{Deserialize, Serialize};

use crate::generated::Mode;
use crate::view::ViewChange;

/// Version of the messages; page and server are of one program, and other programs can compare it.
pub(crate) const PROTOCOL: u32 = 1;

/// Message of a client.
#[derive(Debug, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub(crate) enum ClientMessage {
    /// A frame was shown; its number is of no interest.
    Ack {},
    /// Asks for the wheel, or lets go.
    Drive {
        /// Whether to take it.
        take: bool,
    },
    /// What the engine does.
    #[serde(untagged)]
    Command(Command),
}

/// Command to the engine.
#[derive(Debug, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub(crate) enum Command {
    /// Changes what is drawn.
    View(Box<ViewChange>),
    /// Looks at the log.
    Look(LookChange),
    /// Begins a simulation.
    Simulate(Start),
    /// Hands the wheel over.
    Control {
        /// Name of a driver.
        by: String,
    },
    /// State of a person's controls.
    Keys(Keys),
    /// Runs or pauses.
    Play {
        /// Whether to run.
        playing: Option<bool>,
        /// Times the real time.
        speed: Option<f64>,
    },
    /// Single steps.
    Step {
        /// Number of steps.
        #[serde(default = "one")]
        count: u32,
    },
    /// Begins to generate images, or ends it.
    Generate {
        /// Whether, and whether the simulation waits.
        mode: Mode,
    },
    /// Back to the beginning of the simulation.
    Reset {},
    /// Asks what a pixel shows.
    Pick(Pixel),
    /// Writes the drive as a rollout.
    Save {
        /// Name of the folder.
        name: Option<String>,
    },
    /// Writes the drive's trajectory, so that the command on the page can be run.
    Trajectory {},
}

fn one() -> u32 {
    1
}

/// Change of the recorded state that is shown; fields that are not given stay.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(default)]
pub(crate) struct LookChange {
    /// Time, absolute microseconds.
    pub(crate) t_us: Option<i64>,
    /// Index of a frame.
    pub(crate) frame: Option<usize>,
    /// Forward, meters.
    pub(crate) forward_m: Option<f64>,
    /// To the left, meters.
    pub(crate) left_m: Option<f64>,
    /// To the left, degrees.
    pub(crate) yaw_deg: Option<f64>,
    /// Position of the cameras.
    pub(crate) camera: Option<CameraChange>,
}

/// Change of the cameras' height and pitch.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(default)]
pub(crate) struct CameraChange {
    /// Up, meters.
    pub(crate) up_m: Option<f64>,
    /// Upward, degrees.
    pub(crate) pitch_deg: Option<f64>,
}

/// Beginning of a simulation.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub(crate) struct Start {
    /// Steps per second.
    pub(crate) hz: Option<f64>,
    /// Policy of the actors.
    pub(crate) actors: Option<String>,
    /// Time, absolute microseconds; the time that is shown if not given.
    pub(crate) from_t_us: Option<i64>,
}

/// State of a person's controls.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub(crate) struct Keys {
    /// -1 to 1.
    pub(crate) throttle: f64,
    /// 0 to 1.
    pub(crate) brake: f64,
    /// -1 to 1, positive to the left.
    pub(crate) steer: f64,
    /// Number that the first frame after these keys repeats.
    pub(crate) number: u64,
}

impl Keys {
    /// Returns whether no key is pressed.
    pub(crate) fn is_idle(&self) -> bool {
        self.throttle == 0.0 && self.brake == 0.0 && self.steer == 0.0
    }
}

/// Pixel of an image that is shown.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Pixel {
    /// Name of the camera.
    pub(crate) camera: String,
    /// Column.
    pub(crate) x: u32,
    /// Row.
    pub(crate) y: u32,
}

/// Text message of the server.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub(crate) enum ServerMessage<'a> {
    /// Progress before the first picture.
    Progress {
        /// What is done.
        what: &'a str,
        /// Steps that are done.
        done: usize,
        /// All steps; 0 if unknown.
        of: usize,
    },
    /// Who drives.
    Who {
        /// Whether this client does.
        you_drive: bool,
        /// Number of clients.
        clients: usize,
    },
    /// Counters of this client.
    Counts {
        /// Frames sent.
        sent: u64,
        /// Frames left out.
        dropped: u64,
        /// Number of clients.
        clients: usize,
    },
    /// Something to tell the user.
    Notice {
        /// `info` or `error`.
        level: &'a str,
        /// One line.
        text: &'a str,
    },
}

impl ServerMessage<'_> {
    /// Returns the message as JSON.
    pub(crate) fn json(&self) -> String {
        to_json(self)
    }
}

/// Serializes a message; its types have nothing that JSON lacks.
pub(crate) fn to_json(message: &impl Serialize) -> String {
    serde_json::to_string(message).unwrap_or_else(|_| "{}".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_have_a_type() {
        let read = |text: &str| serde_json::from_str::<ClientMessage>(text);
        assert!(matches!(read(r#"{"type": "ack", "frame": 7}"#), Ok(ClientMessage::Ack {})));
        assert!(matches!(
            read(r#"{"type": "keys", "throttle": 1}"#),
            Ok(ClientMessage::Command(Command::Keys(Keys { throttle: 1.0, brake: 0.0, .. })))
        ));
        assert!(matches!(read(r#"{"type": "reset"}"#), Ok(ClientMessage::Command(Command::Reset {}))));
        assert!(matches!(
            read(r#"{"type": "step"}"#),
            Ok(ClientMessage::Command(Command::Step { count: 1 }))
        ));
        for wrong in ["", "[]", "7", r#"{"type": "fly"}"#, r#"{"frame": 1}"#] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }
}
