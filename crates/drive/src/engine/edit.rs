//! Edits of the log's actors: a log has its edits from the first step on, so a simulation begins anew.

use std::time::Instant;

use pskel_sim::ActorPolicy;

use super::kept::{Kept, Shown};
use super::live::Live;
use super::{Engine, Stage};
use crate::message::ServerMessage;

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

    /// Returns whether the scenario or the page has edited the log.
    pub(super) fn is_edited(&self) -> bool {
        !self.inputs.log.recording().edits.is_empty()
    }

    /// Returns whether the actors of a simulation are those of the recorded images.
    pub(super) fn actors_follow_log(&self, live: &Live<'a>) -> bool {
        live.beginning.actors == ActorPolicy::Replay && !self.is_edited()
    }
}
