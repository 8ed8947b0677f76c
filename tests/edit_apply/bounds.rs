//! Error bounds and densities stay what they promise under edits.

use super::*;

/// Edits that don't leave the range of heights on the terrain, and say so.
fn tame_edits(size: [u32; 2]) -> impl Strategy<Value = Edit> {
    edits(size).prop_map(|mut edit| {
        match &mut edit.change {
            Change::Crater {
                depth,
                rim,
                may_clamp,
                ..
            } => {
                (*depth, *rim, *may_clamp) = (*depth / 4, *rim / 4, false);
            }
            Change::Raise { by, may_clamp, .. } => (*by, *may_clamp) = (*by / 8, false),
            Change::Stamp { by, may_clamp, .. } => (*by, *may_clamp) = (*by / 8, false),
            Change::Flatten {
                to, least, most, ..
            } => {
                *to = 30_000;
                (*least, *most) = (*least / 8, *most / 8);
            }
            Change::Smooth { least, most, .. } => (*least, *most) = (*least / 8, *most / 8),
            _ => {}
        }
        edit
    })
}

/// Looks for triangles on the edited ground that are further from it than a bound says.
fn check_bounds(
    terrain: &Terrain,
    tiles: &Edited,
    around: &[Edit],
    seed: u64,
) -> Result<(), TestCaseError> {
    let mut random = Random(seed);
    for level in 0..terrain.ground.levels() {
        let ground = terrain.level(tiles, level)?;
        let texels = ground.size.map(|samples| (samples - 1).div_ceil(4));
        for _ in 0..3000 {
            // Near an edit, where bounds have changed.
            let edit = &around[(random.unit() * around.len() as f64) as usize];
            let texel = [0, 1].map(|axis| {
                let unit = f64::from(EDIT_UNITS << level);
                let reach = f64::from(edit.reach) / unit + 20.0;
                let at = f64::from(edit.centre[axis]) / unit + random.between(-reach, reach);
                ((at / 4.0).max(0.0) as u32).min(texels[axis] - 1)
            });
            let spacing = match (random.unit() * 3.0) as u32 {
                0 => f64::from(1 << (random.unit() * 7.0) as u32),
                1 => 2_f64.powf(random.between(-4.0, 1.0)),
                _ => 2_f64.powf(random.between(0.0, 6.0)),
            };
            let triangle = random_triangle(&mut random, texel, spacing);
            if !ground.holds(&triangle) || !meets(&triangle, texel) {
                continue;
            }
            let (worst, long) = (ground.worst(&triangle), longest_edge(&triangle));
            let [x, z] = texel;
            let tile = tiles[&TileAddress::new(level, x / 32, z / 32)].tile();
            let limit = bound(&tile.errors.get(x % 32, z % 32), long).expect("at most 64");
            prop_assert!(
                worst <= limit + 1e-6,
                "{} > {} at level {}, texel {:?}, edges up to {}: {:?}",
                worst,
                limit,
                level,
                texel,
                long,
                triangle
            );
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(config(40))]

    #[test]
    fn no_triangle_is_further_from_the_edited_ground_than_the_bound(
        edits in prop::collection::vec(tame_edits(smooth().file.size), 1..4),
        seed in any::<u64>(),
    ) {
        let terrain = smooth();
        let tiles = terrain.after(&edits);
        check_bounds(terrain, &tiles, &edits, seed)?;
    }

    #[test]
    fn bounds_hold_where_the_ground_is_cut_off(
        edits in prop::collection::vec(edits(smooth().file.size), 1..4),
        up in any::<bool>(),
        seed in any::<u64>(),
    ) {
        // Near an end of the range of heights.
        let mut all = vec![Edit {
            centre: [200 * EDIT_UNITS, 190 * EDIT_UNITS],
            reach: MAX_REACH,
            change: Change::Raise {
                by: if up { 65_000 } else { -65_000 },
                hardness: 0,
                density: 0,
                may_clamp: true,
            },
        }];
        all.extend(edits);
        let tiles = smooth().after(&all);
        check_bounds(smooth(), &tiles, &all, seed)?;
    }
}

/// Whether no tile's bounds and boosts are less than those of its children.
fn check_parents(tiles: &Edited) {
    for (address, tile) in tiles {
        let Some(parent) = tiles.get(&address.parent()) else {
            continue;
        };
        for z in 0..32 {
            for x in 0..32 {
                let texel = tile.tile().errors.get(x, z);
                let [px, pz] =
                    [(address.x, x), (address.z, z)].map(|(tile, at)| (tile % 2 * 32 + at) / 2);
                let above = parent.tile().errors.get(px, pz);
                for k in 0..6 {
                    assert!(
                        above[k] >= texel[k + 1],
                        "{address} {x} {z}: {texel:?} {above:?}"
                    );
                }
                assert!(texel[..7].is_sorted());
            }
        }
    }
}

proptest! {
    #![proptest_config(config(30))]

    #[test]
    fn parents_bounds_are_no_less_than_their_childrens(
        edits in prop::collection::vec(edits(rough().file.size), 1..6),
    ) {
        check_parents(&rough().after(&edits));
    }

    #[test]
    fn texels_that_a_crater_meets_have_at_least_its_density_and_so_have_their_parents(
        x in place(420), z in place(391), reach in reaches(), density in 1..=255_u8,
    ) {
        let mut edit = crater([x, z], reach);
        if let Change::Crater { density: own, .. } = &mut edit.change {
            *own = density;
        }
        let tiles = smooth().after(&[edit]);
        let texels = |level: u8| smooth().file.samples(level).map(|samples| (samples - 1).div_ceil(4));
        for (address, tile) in &tiles {
            let count = texels(address.level);
            let unit = f64::from((4 * EDIT_UNITS) << address.level);
            for row in 0..32 {
                for column in 0..32 {
                    let at = [address.x * 32 + column, address.z * 32 + row];
                    if at[0] >= count[0] || at[1] >= count[1] {
                        continue;
                    }
                    // Of the part of the texel on the terrain.
                    let nearest = [(at[0], x, 420), (at[1], z, 391)].map(|(at, centre, size)| {
                        let start = f64::from(at) * unit;
                        let end = (start + unit).min(f64::from((size - 1) * EDIT_UNITS));
                        f64::from(centre) - f64::from(centre).clamp(start, end)
                    });
                    let own = tile.tile().densities.get(column as i32, row as i32);
                    if nearest[0].hypot(nearest[1]) < f64::from(reach) {
                        assert!(own >= density, "{address} {column} {row}: {own} < {density}");
                    }
                }
            }
        }
    }
}
