//! Edits of the log's actors: a log has its edits from the first step on, so a simulation begins anew.

use std::time::Instant;

use pskel_sim::ActorPolicy;

use super::live::{Beginning, Live};
use super::look::Look;
use super::{Engine, Stage};
use crate::generated::Mode;
use crate::message::ServerMessage;
use crate::view::View;

/// What an engine keeps when its log is edited.
pub(super) struct Kept {
    view: View,
    shown: Shown,
    mode: Mode,
    /// Number of the last session of the generator.
    session: u64,
    frame: u64,
    saved: usize,
}

/// What is shown.
enum Shown {
    Look(Look),
    Live(Beginning),
}

impl<'a> Engine<'a> {
    /// Returns what is kept.
    pub(super) fn keep(self) -> Kept {
        let shown = match &self.stage {
            Stage::Look(look) => Shown::Look(*look),
            Stage::Live(live) => Shown::Live(live.beginning),
        };
        let (mode, session) = (self.generation.mode, self.generation.session());
        Kept { view: self.view, shown, mode, session, frame: self.frame, saved: self.saved }
    }

    /// Goes on where the engine of the log before its edits was: a simulation begins anew, paused.
    pub(super) fn restore(&mut self, kept: Kept) {
        let Kept { view, shown, mode, session, frame, saved } = kept;
        (self.view, self.frame, self.saved) = (view, frame, saved);
        self.generation.continue_after(session, mode);
        let (level, text) = match shown {
            Shown::Look(look) => {
                self.stage = Stage::Look(look);
                return;
            }
            Shown::Live(beginning) => match self.begin(beginning, Instant::now()) {
                Ok(()) => ("info", "the actors have changed: the simulation begins anew".to_owned()),
                Err(error) => ("error", error),
            },
        };
        self.hub.tell(None, ServerMessage::Notice { level, text: &text }.json());
    }

    /// Returns whether the actors of a simulation are those of the recorded images.
    pub(super) fn actors_follow_log(&self, live: &Live<'a>) -> bool {
        live.beginning.actors == ActorPolicy::Replay && self.view.edits.is_empty()
    }
}
