//! Which parts of a page have changed.

use crate::edit::SampleRect;
use std::collections::VecDeque;

/// Changes of a page that are remembered: what isn't drawn for longer is written as a whole.
const REMEMBERED: usize = 16;

/// The parts of a page that have changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct PageDirt {
    /// Stored samples, 0 to 133.
    pub(crate) heights: SampleRect,
    /// The tile's own texels, 0 to 32.
    pub(crate) densities: SampleRect,
    /// The same.
    pub(crate) errors: SampleRect,
}

impl PageDirt {
    /// What is in either.
    #[cfg(any(feature = "render", test))]
    fn union(&self, other: &Self) -> Self {
        Self {
            heights: self.heights.union(&other.heights),
            densities: self.densities.union(&other.densities),
            errors: self.errors.union(&other.errors),
        }
    }
}

/// What has changed of a page from one content to the next, the latest last.
#[derive(Debug, Default)]
pub(super) struct PageDirtLog(VecDeque<(u64, PageDirt)>);

impl PageDirtLog {
    /// Notes what has changed since the content had the number `before`.
    pub(super) fn note(&mut self, before: u64, dirt: PageDirt) {
        if self.0.len() == REMEMBERED {
            self.0.pop_front();
        }
        self.0.push_back((before, dirt));
    }

    /// What has changed since the content had the number `known`.
    #[cfg(any(feature = "render", test))]
    pub(super) fn since(&self, known: u64) -> Option<PageDirt> {
        let first = self.0.iter().position(|(before, _)| *before == known)?;
        let later = self.0.iter().skip(first).map(|(_, dirt)| *dirt);
        later.reduce(|all, dirt| all.union(&dirt))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_changed_since_a_content_is_all_that_came_after() {
        let rect = |at: i32| SampleRect::new([at, at], [at + 2, at + 3]);
        let dirt = |at: i32| PageDirt {
            heights: rect(at),
            ..PageDirt::default()
        };
        let mut log = PageDirtLog::default();
        assert_eq!(log.since(0), None, "nothing is known");
        for number in 0..40 {
            log.note(number, dirt(number as i32));
        }
        assert_eq!(log.since(39), Some(dirt(39)));
        let since = log.since(30).map(|dirt| dirt.heights);
        assert_eq!(since, Some(SampleRect::new([30, 30], [41, 42])));
        assert_eq!(log.since(23), None, "too long ago");
        assert!(log.since(24).is_some());
        assert_eq!(log.since(40), None, "that is now");
    }
}
