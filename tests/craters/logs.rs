//! Logs that take another's place, are merged, or are not of this terrain.

use super::*;

impl Grounds {
    fn replace_log(&mut self, log: EditLog) {
        let terrain = self.terrain;
        let edits = TerrainEdits::new(log);
        self.world.app.world_mut().entity_mut(terrain).insert(edits);
    }

    /// Runs frames until the ground has this hash.
    fn wait_for(&mut self, hash: u128) {
        let terrain = self.terrain;
        self.world
            .run_until("the ground is as it should be", |world| {
                let state = world.get::<TerrainState>(terrain).expect("is there");
                state.ground_hash(&EVERYTHING) == Some(hash)
            });
    }
}

#[test]
fn a_log_that_takes_anothers_place_leaves_nothing_of_it() {
    let mut grounds = Grounds::whole();
    let baked = grounds.hash();
    let mut draw = Draw(21);
    // Enough for snapshots, which are being made when the other log comes.
    for _ in 0..600 {
        let at = Vec3::new(570.0 + 60.0 * draw.next(), 0.0, 370.0 + 60.0 * draw.next());
        grounds.trigger(Crater::at(at).radius(3.0));
    }
    let edited = grounds.hash();
    let old = grounds.log().clone();
    let mut log = EditLog::new(&grounds.state().manifest().file);
    let mut other = Grounds::whole();
    for number in 0..700 {
        let at = Vec3::new(400.0 + 0.3 * number as f32, 0.0, 380.0);
        other.trigger(Crater::at(at).radius(4.0));
    }
    log.merge(other.log().diff(0))
        .expect("an empty log takes any");
    grounds.replace_log(log);
    grounds.wait_for(other.hash());
    for _ in 0..50 {
        grounds.world.frame();
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    // Whatever was kept of the first one would show now.
    grounds.trigger(UndoEdit {
        sequence: Some(650),
        ..default()
    });
    other.trigger(UndoEdit {
        sequence: Some(650),
        ..default()
    });
    other.world.settle(other.terrain);
    grounds.wait_for(other.hash());
    assert!(
        !grounds.world.told().reloaded.is_empty(),
        "who follows tiles is told"
    );
    // And back again.
    grounds.replace_log(old);
    grounds.wait_for(edited);
    let terrain = grounds.terrain;
    let world = grounds.world.app.world_mut();
    world.entity_mut(terrain).remove::<TerrainEdits>();
    grounds.wait_for(baked);
    grounds.trigger(Crater::at(Vec3::new(300.0, 0.0, 300.0)));
    assert_eq!(grounds.log().len(), 1);
}

#[test]
fn a_foreign_log_changes_nothing_and_says_so() {
    let mut foreign = Grounds::of([400, 300]);
    foreign.trigger(Crater::at(Vec3::new(300.0, 0.0, 300.0)));
    let mut grounds = Grounds::whole();
    let baked = grounds.hash();
    grounds.trigger(Crater::at(Vec3::new(300.0, 0.0, 300.0)));
    let own = grounds.log().clone();
    let edited = grounds.hash();
    assert_ne!(edited, baked);
    grounds.replace_log(foreign.log().clone());
    grounds.world.frame();
    assert_eq!(grounds.hash(), baked);
    let said = |grounds: &Grounds| {
        let refused = grounds.heard().refused.iter();
        refused
            .filter(|text| text.contains("shown without its edits"))
            .count()
    };
    grounds.world.frame();
    assert_eq!(said(&grounds), 1, "{:?}", grounds.heard());
    grounds.trigger(Crater::at(Vec3::new(300.0, 0.0, 300.0)));
    assert_eq!(grounds.hash(), baked);
    assert!(
        grounds
            .heard()
            .refused
            .iter()
            .any(|text| text.starts_with("Crater can't be"))
    );
    grounds.trigger(UndoEdit::default());
    let diff = foreign.log().diff(0);
    grounds.trigger(MergeEdits {
        terrain: None,
        diff,
    });
    grounds.world.frame();
    assert_eq!(grounds.hash(), baked);
    assert!(grounds.log() == foreign.log(), "nothing is lost");
    grounds.replace_log(own);
    grounds.world.frame();
    assert_eq!(grounds.hash(), edited);
}

#[test]
fn a_snapshot_that_is_made_amid_a_merge_has_what_it_says() {
    let mut server = Grounds::whole();
    let mut client = Grounds::new();
    let region = TerrainRegion::around(Vec2::new(600.0, 400.0), 50.0);
    let pin = client.pin(region);
    let mut draw = Draw(31);
    let mut dig = |server: &mut Grounds, count: usize| {
        for _ in 0..count {
            let at = Vec3::new(570.0 + 60.0 * draw.next(), 0.0, 370.0 + 60.0 * draw.next());
            server.trigger(Crater::at(at).radius(3.0));
        }
    };
    // The 256th edit of the tile comes in the middle of the second part.
    for count in [250, 20] {
        dig(&mut server, count);
        while client.log().last_sequence() < server.log().last_sequence() {
            let mut diff = server.log().diff(client.log().last_sequence());
            diff.ops.truncate(20);
            client.trigger(MergeEdits {
                terrain: None,
                diff,
            });
        }
    }
    let wanted = server.state().ground_hash(&region);
    assert_eq!(client.state().ground_hash(&region), wanted);
    for _ in 0..100 {
        client.world.frame();
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    assert!(!client.log().snapshots().is_empty());
    // A log with its snapshots and nothing else makes the same.
    let saved = EditLog::decode(&client.log().encode()).expect("just encoded");
    client.world.app.world_mut().despawn(pin);
    let mut other = Grounds::new();
    other.replace_log(saved);
    other.world.frame();
    other.pin(region);
    assert_eq!(other.state().ground_hash(&region), wanted);
}

#[test]
fn what_was_undone_before_it_came_changes_nothing() {
    let mut server = Grounds::whole();
    let mut client = Grounds::whole();
    for grounds in [&mut server, &mut client] {
        grounds.trigger(Crater::at(Vec3::new(300.0, 0.0, 300.0)).radius(20.0));
    }
    server.trigger(Crater::at(Vec3::new(310.0, 0.0, 300.0)).radius(20.0));
    server.trigger(UndoEdit::default());
    let version = client.state().pages_version();
    let diff = server.log().diff(1);
    client.trigger(MergeEdits {
        terrain: None,
        diff,
    });
    client.world.frame();
    client.world.frame();
    assert_eq!(
        client.state().pages_version(),
        version,
        "nothing was made anew"
    );
    assert_eq!(client.hash(), server.hash());
}

#[test]
fn a_long_log_that_is_merged_at_once_makes_the_same_ground() {
    let mut there = Grounds::whole();
    let mut draw = Draw(77);
    for _ in 0..1500 {
        let at = draw
            .place()
            .clamp(Vec3::ZERO, Vec3::new(1390.0, 0.0, 990.0));
        there.trigger(Crater::at(at).radius(2.0 + 5.0 * draw.next()));
    }
    let mut late = Grounds::whole();
    let diff = there.log().diff(0);
    late.trigger(MergeEdits {
        terrain: None,
        diff,
    });
    // In the background, and while it is on its way more happens.
    let pass_on = |there: &Grounds, late: &mut Grounds| {
        let diff = there.log().diff(late.log().last_sequence());
        late.trigger(MergeEdits {
            terrain: None,
            diff,
        });
    };
    there.trigger(Crater::at(Vec3::new(700.0, 0.0, 500.0)).radius(30.0));
    pass_on(&there, &mut late);
    there.trigger(UndoEdit {
        sequence: Some(700),
        ..default()
    });
    pass_on(&there, &mut late);
    late.world.frame();
    there.trigger(Crater::at(Vec3::new(650.0, 0.0, 500.0)).radius(30.0));
    pass_on(&there, &mut late);
    assert!(
        late.heard().refused.is_empty(),
        "{:?}",
        late.heard().refused
    );
    there.world.settle(there.terrain);
    late.world.settle(late.terrain);
    let wanted = there.hash();
    assert_eq!(late.hash(), wanted);
    // The same as tile by tile.
    let mut fresh = Grounds::new();
    let diff = there.log().diff(0);
    fresh.trigger(MergeEdits {
        terrain: None,
        diff,
    });
    fresh.pin(EVERYTHING);
    fresh.wait_for(wanted);
}

#[test]
fn bounds_of_ground_that_is_not_resident_follow_what_is_taken_back() {
    let hill = |x: f32, by_m: f32| Raise {
        radius_m: 60.0,
        by_m,
        ..Raise::at(Vec3::new(x, 0.0, 400.0))
    };
    let bounds = |grounds: &Grounds| {
        let index = &grounds.state().ground_bounds().index;
        index.iter().collect::<Vec<_>>()
    };
    let undo = |sequence| UndoEdit {
        sequence: Some(sequence),
        ..default()
    };
    let mut second_alone = Grounds::new();
    let baked = bounds(&second_alone);
    second_alone.trigger(hill(640.0, -70.0));
    let mut both = Grounds::new();
    let mut joins = Grounds::new();
    both.trigger(hill(600.0, 90.0));
    let merge = |from: &Grounds, into: &mut Grounds| {
        let diff = from.log().diff(into.log().last_sequence());
        into.trigger(MergeEdits {
            terrain: None,
            diff,
        });
    };
    merge(&both, &mut joins);
    both.trigger(hill(640.0, -70.0));
    assert_ne!(bounds(&both), bounds(&second_alone));
    both.trigger(undo(1));
    assert_eq!(bounds(&both), bounds(&second_alone));
    // What comes from others together with what they have taken back.
    merge(&both, &mut joins);
    assert_eq!(bounds(&joins), bounds(&second_alone));
    both.trigger(undo(2));
    assert_eq!(bounds(&both), baked);
}
