//! The pages that all terrains share.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Hands out page numbers, the least free one first, so that the memory behind them grows only as
/// far as it is used.
#[derive(Debug, Default)]
pub(crate) struct PagePool {
    free: BinaryHeap<Reverse<u32>>,
    /// The terrain state that holds each page, by its instance; 0 where it is free.
    owners: Vec<u64>,
    /// Pages from here on are not handed out any more.
    limit: u32,
    used: u32,
}

impl PagePool {
    /// Pages that may be in use at once.
    pub(crate) const fn limit(&self) -> u32 {
        self.limit
    }

    /// One more than the greatest page that is in use or may come into use.
    pub(crate) fn capacity(&self) -> u32 {
        self.owners.len() as u32
    }

    /// Pages in use.
    pub(crate) const fn used(&self) -> u32 {
        self.used
    }

    /// Pages that can be handed out at once.
    #[cfg(test)]
    pub(crate) fn free_count(&self) -> usize {
        self.limit.saturating_sub(self.used) as usize
    }

    /// Changes how many pages there are. Those in use beyond the limit stay until they are given
    /// back.
    pub(crate) fn set_limit(&mut self, limit: u32) {
        if limit == self.limit {
            return;
        }
        self.limit = limit;
        self.rebuild();
    }

    fn rebuild(&mut self) {
        let last = self.owners.iter().rposition(|&owner| owner != 0);
        let length = last.map_or(0, |last| last + 1).max(self.limit as usize);
        self.owners.resize(length, 0);
        let owners = (0..).zip(&self.owners[..self.limit as usize]);
        self.free = owners
            .filter(|(_, owner)| **owner == 0)
            .map(|(page, _)| Reverse(page))
            .collect();
        self.used = self.owners.iter().filter(|&&owner| owner != 0).count() as u32;
    }

    /// The least free page for the state `instance`; `None` where as many are in use as may be.
    pub(crate) fn take(&mut self, instance: u64) -> Option<u32> {
        if self.used >= self.limit {
            return None;
        }
        let Reverse(page) = self.free.pop()?;
        self.owners[page as usize] = instance;
        self.used += 1;
        Some(page)
    }

    /// Gives a page back.
    pub(crate) fn give_back(&mut self, page: u32) {
        let Some(owner) = self
            .owners
            .get_mut(page as usize)
            .filter(|owner| **owner != 0)
        else {
            return;
        };
        *owner = 0;
        self.used -= 1;
        if page < self.limit {
            self.free.push(Reverse(page));
        } else {
            let last = self.owners.iter().rposition(|&owner| owner != 0);
            let length = last.map_or(0, |last| last + 1).max(self.limit as usize);
            self.owners.truncate(length);
        }
    }

    /// Takes back the pages of states that are no more.
    pub(crate) fn reclaim(&mut self, lives: impl Fn(u64) -> bool) {
        let mut changed = false;
        for owner in &mut self.owners {
            if *owner != 0 && !lives(*owner) {
                *owner = 0;
                changed = true;
            }
        }
        if changed {
            self.rebuild();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    #[test]
    fn pages_beyond_a_lowered_limit_stay_until_they_are_given_back() {
        let mut pool = PagePool::default();
        pool.set_limit(4);
        let pages: Vec<_> = std::iter::from_fn(|| pool.take(7)).collect();
        assert_eq!(pages, [0, 1, 2, 3]);
        pool.set_limit(2);
        assert_eq!((pool.capacity(), pool.used(), pool.free_count()), (4, 4, 0));
        pool.give_back(1);
        pool.give_back(2);
        assert_eq!(pool.take(7), None, "two are in use");
        pool.give_back(3);
        assert_eq!(pool.capacity(), 2);
        assert_eq!(pool.take(7), Some(1));
        pool.reclaim(|_| false);
        assert_eq!((pool.used(), pool.free_count()), (0, 2));
    }

    proptest! {
        #[test]
        fn no_page_has_two_owners_and_none_is_lost(
            steps in prop::collection::vec((0u8..4, 0u32..20, 1u64..4), 1..200),
        ) {
            let mut pool = PagePool::default();
            let mut held = BTreeMap::new();
            for (what, page, owner) in steps {
                match what {
                    0 | 1 => {
                        if let Some(page) = pool.take(owner) {
                            prop_assert!(page < pool.limit());
                            prop_assert_eq!(held.insert(page, owner), None);
                        } else {
                            prop_assert!(held.len() >= pool.limit() as usize);
                        }
                    }
                    2 => {
                        pool.give_back(page);
                        held.remove(&page);
                    }
                    _ if owner == 1 => {
                        pool.reclaim(|of| of != 2);
                        held.retain(|_, of| *of != 2);
                    }
                    _ => pool.set_limit(page),
                }
                prop_assert_eq!(pool.used() as usize, held.len());
                let free = (pool.limit() as usize).saturating_sub(held.len());
                prop_assert_eq!(pool.free_count(), free);
                let last = held.keys().next_back().map_or(0, |&page| page + 1);
                prop_assert_eq!(pool.capacity(), last.max(pool.limit()));
            }
        }
    }
}
