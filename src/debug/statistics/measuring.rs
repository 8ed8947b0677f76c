//! What is measured only while somebody looks at it.

use crate::debug::map::FlightPlugin;
use crate::render::TerrainStatistics;
use crate::terrain::TerrainCpuTimes;
use bevy::prelude::*;

/// Ends what a [`StatisticsTab`](super::StatisticsTab) has asked to be measured as soon as it isn't
/// seen any more: when another tab lies over it, when the panel is closed, when another camera is
/// chosen. Without it nothing is measured that isn't measured anyway. What a game sets meanwhile is
/// left as it is, then and afterwards.
///
/// It also ends flights of the [`MapTab`](super::super::MapTab) at their goals when the panel is closed on
/// the way.
#[derive(Clone, Copy, Debug, Default)]
pub struct StatisticsTabPlugin;

impl Plugin for StatisticsTabPlugin {
    fn build(&self, app: &mut App) {
        app.add_plugins(FlightPlugin)
            .init_resource::<Measuring>()
            .add_systems(First, stop_unseen);
    }
}

/// Something that is measured if the game wants it, or while a tab does.
#[derive(Clone, Copy, Debug)]
struct Flag {
    /// What it is without the tab.
    own: bool,
    /// What it was set to for the tab.
    written: bool,
    /// Whether somebody has set it since: then the tab's wishes count no more.
    is_overruled: bool,
}

impl Flag {
    const fn new(now: bool) -> Self {
        Self {
            own: now,
            written: now,
            is_overruled: false,
        }
    }

    /// What it is to be where it is `now` and the tab asks for it or not.
    fn ask(&mut self, now: bool, asked: bool) -> bool {
        if now != self.written {
            self.own = now;
            self.is_overruled = true;
        }
        self.written = self.own || (asked && !self.is_overruled);
        self.written
    }

    /// What it is to be when the tab asks for nothing any more.
    fn end(mut self, now: bool) -> bool {
        self.ask(now, false)
    }
}

/// A camera whose triangles are measured.
#[derive(Debug)]
struct Asked {
    camera: Entity,
    triangle_sizes: Flag,
    savings: Flag,
    seen: u64,
}

impl Asked {
    const fn new(camera: Entity, statistics: &TerrainStatistics, seen: u64) -> Self {
        Self {
            camera,
            triangle_sizes: Flag::new(statistics.measure_triangle_sizes),
            savings: Flag::new(statistics.measure_savings),
            seen,
        }
    }

    /// Has what is asked for measured, beside what somebody else has.
    fn write(&mut self, world: &mut World, [sizes, savings]: [bool; 2]) {
        if let Some(mut statistics) = world.get_mut::<TerrainStatistics>(self.camera) {
            let now = [
                statistics.measure_triangle_sizes,
                statistics.measure_savings,
            ];
            let wanted = [
                self.triangle_sizes.ask(now[0], sizes),
                self.savings.ask(now[1], savings),
            ];
            if wanted != now {
                [
                    statistics.measure_triangle_sizes,
                    statistics.measure_savings,
                ] = wanted;
            }
        }
    }
}

/// What tabs have asked for, and when they last did.
#[derive(Resource, Debug, Default)]
pub(super) struct Measuring {
    frame: u64,
    asked: Option<Asked>,
    /// CPU times, and when they were last asked for.
    times: Option<(Flag, u64)>,
}

impl Measuring {
    /// Has a camera's savings counted, and its triangles measured if `sizes`, in this frame and the
    /// next.
    pub(super) fn ask(world: &mut World, camera: Entity, sizes: bool) {
        world.try_resource_scope(|world, mut measuring: Mut<Self>| {
            let seen = measuring.frame;
            let former = measuring.asked.take_if(|asked| asked.camera != camera);
            if let Some(mut former) = former {
                former.write(world, [false; 2]);
            }
            if measuring.asked.is_none() {
                let statistics = world.get::<TerrainStatistics>(camera);
                measuring.asked = statistics.map(|now| Asked::new(camera, now, seen));
            }
            if let Some(asked) = &mut measuring.asked {
                asked.seen = seen;
                asked.write(world, [sizes, true]);
            }
        });
    }

    /// Has the CPU times of the terrains' systems taken, in this frame and the next.
    pub(super) fn ask_times(world: &mut World) {
        world.try_resource_scope(|world, mut measuring: Mut<Self>| {
            let Some(times) = world.get_resource::<TerrainCpuTimes>() else {
                return;
            };
            let frame = measuring.frame;
            let now = times.is_measured();
            let (flag, seen) = measuring
                .times
                .get_or_insert_with(|| (Flag::new(now), frame));
            *seen = frame;
            let wanted = flag.ask(now, true);
            if wanted != now {
                times.set_measured(wanted);
            }
        });
    }
}

fn stop_unseen(world: &mut World) {
    world.resource_scope(|world, mut measuring: Mut<Measuring>| {
        measuring.frame += 1;
        let frame = measuring.frame;
        // What was seen in the frame before is most likely seen in this one.
        let is_unseen = |seen: u64| seen + 1 < frame;
        if let Some(mut asked) = measuring.asked.take_if(|asked| is_unseen(asked.seen)) {
            asked.write(world, [false; 2]);
        }
        if let Some((flag, _)) = measuring.times.take_if(|(_, seen)| is_unseen(*seen))
            && let Some(times) = world.get_resource::<TerrainCpuTimes>()
        {
            let now = times.is_measured();
            let wanted = flag.end(now);
            if wanted != now {
                times.set_measured(wanted);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flag_goes_back_unless_somebody_has_set_it() {
        for own in [false, true] {
            let mut flag = Flag::new(own);
            let now = flag.ask(own, true);
            assert!(now && flag.ask(now, true));
            assert_eq!(flag.end(now), own);
            // What somebody sets meanwhile stays, whatever is asked for.
            let now = flag.ask(false, true);
            assert!(!now && !flag.ask(now, true) && !flag.end(now));
            let now = flag.ask(true, false);
            assert!(now && flag.ask(now, false) && flag.end(now));
        }
    }
}
