//! Which parts of a table have changed since a copy of it was made.

use std::collections::VecDeque;
use std::ops::Range;

/// Changes that are remembered; who is further behind copies the whole table.
const REMEMBERED: usize = 1024;

/// The latest changes of a table whose version rises with each.
#[derive(Debug)]
pub(crate) struct ChangeLog {
    version: u64,
    changes: VecDeque<(u64, Range<u32>)>,
    /// The latest version whose change is not remembered.
    forgotten: u64,
}

impl Default for ChangeLog {
    fn default() -> Self {
        Self {
            version: 1,
            changes: VecDeque::new(),
            forgotten: 1,
        }
    }
}

impl ChangeLog {
    /// The version: 1 for a table that has never changed. No copy has version 0.
    pub(crate) const fn version(&self) -> u64 {
        self.version
    }

    /// Raises the version because of something that is not in the table.
    pub(crate) const fn touch(&mut self) {
        self.version += 1;
    }

    /// Notes that entries have changed.
    pub(crate) fn note(&mut self, entries: Range<u32>) {
        self.version += 1;
        if self.changes.len() == REMEMBERED
            && let Some((version, _)) = self.changes.pop_front()
        {
            self.forgotten = version;
        }
        self.changes.push_back((self.version, entries));
    }

    #[cfg(any(feature = "render", test))]
    /// What has changed since version `known`; `None` where that is too long ago to tell.
    pub(crate) fn since(&self, known: u64) -> Option<impl Iterator<Item = Range<u32>> + '_> {
        (known >= self.forgotten).then(|| {
            let changes = self.changes.iter().rev();
            changes
                .take_while(move |(version, _)| *version > known)
                .map(|(_, entries)| entries.clone())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_copy_that_follows_the_log_is_the_table() {
        let mut log = ChangeLog::default();
        let mut table = vec![0_u32; 50];
        let (mut copy, mut known) = (Vec::new(), 0);
        let mut whole = 0;
        for step in 0..9000_u32 {
            let at = step * 7 % 50;
            let end = (at + step % 3 + 1).min(50);
            table[at as usize..end as usize].fill(step);
            log.note(at..end);
            if step % 11 == 0 {
                log.touch();
            }
            // Now and then the copy falls behind.
            if step % 3000 < 1500 && step % 4 == 0 {
                match log.since(known) {
                    None => {
                        whole += 1;
                        copy.clone_from(&table);
                    }
                    Some(changes) => {
                        for range in changes {
                            let range = range.start as usize..range.end as usize;
                            copy[range.clone()].copy_from_slice(&table[range]);
                        }
                    }
                }
                known = log.version();
                assert_eq!(copy, table, "after step {step}");
            }
        }
        assert_eq!(whole, 3, "at first, and twice after a long while");
    }
}
