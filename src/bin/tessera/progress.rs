//! Progress on a terminal.

use bevy_tessera::bake::{BakeProgress, BakeStage};
use indicatif::{HumanCount, ProgressBar, ProgressState, ProgressStyle};
use std::fmt;
use std::io::IsTerminal;
use std::sync::Mutex;

/// A progress bar with rate and time left, which `indicatif` hides unless standard error is a
/// terminal.
#[derive(Default)]
pub struct Bar {
    bar: Mutex<Option<ProgressBar>>,
}

impl Bar {
    pub fn start(&self, what: &'static str, length: u64, unit: &str) {
        if !std::io::stderr().is_terminal() {
            return;
        }
        let bar = ProgressBar::new(length);
        let style = format!(
            "{{msg:>7}} [{{wide_bar}}] {{percent:>3}} %  {{human_pos}} {unit}, {{rate}}/s, \
             {{eta}} left"
        );
        if let Ok(style) = ProgressStyle::with_template(&style) {
            let style =
                style.with_key("rate", |state: &ProgressState, out: &mut dyn fmt::Write| {
                    let _ = write!(out, "{}", HumanCount(state.per_sec() as u64));
                });
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message(what);
        self.replace(Some(bar));
    }

    pub fn more(&self, steps: u64) {
        let held = self.bar.lock().unwrap_or_else(|poison| poison.into_inner());
        if let Some(bar) = held.as_ref() {
            bar.inc(steps);
        }
    }

    fn replace(&self, bar: Option<ProgressBar>) {
        let mut held = self.bar.lock().unwrap_or_else(|poison| poison.into_inner());
        if let Some(old) = held.take() {
            old.finish_and_clear();
        }
        *held = bar;
    }

    pub fn clear(&self) {
        self.replace(None);
    }
}

impl BakeProgress for Bar {
    fn stage(&self, stage: BakeStage, samples: u64) {
        let (what, unit) = match stage {
            BakeStage::Survey => ("survey", "samples"),
            BakeStage::Fill => ("fill", "samples"),
            BakeStage::Bake => ("bake", "samples"),
            BakeStage::Merge => ("check", "tiles"),
            BakeStage::Density => ("density", "tiles"),
            BakeStage::Apply => ("apply", "tiles"),
            BakeStage::Pack => ("pack", "tiles"),
            BakeStage::Unpack => ("unpack", "tiles"),
            _ => return self.clear(),
        };
        self.start(what, samples, unit);
    }

    fn advance(&self, samples: u64) {
        self.more(samples);
    }
}
