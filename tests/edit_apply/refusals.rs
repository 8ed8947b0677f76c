//! Edits that make no sense are refused.

use super::*;

#[test]
fn what_can_not_be_is_refused() {
    let good = crater([0; 2], 640);
    assert_eq!(good.validate(), Ok(()));
    let with = |change: Change| Edit {
        change,
        ..good.clone()
    };
    for reach in [0, MIN_REACH - 1, MAX_REACH + 1, u32::MAX] {
        let edit = Edit {
            reach,
            ..good.clone()
        };
        assert_eq!(edit.validate(), Err(InvalidEdit::Reach { found: reach }));
    }
    for at in [i32::MIN, i32::MAX, (1 << 30) + 641, -(1 << 30) - 641] {
        let edit = Edit {
            centre: [3, at],
            ..good.clone()
        };
        assert!(matches!(edit.validate(), Err(InvalidEdit::Centre { .. })));
    }
    let numbers = |edit: &Edit| matches!(edit.validate(), Err(InvalidEdit::Number { .. }));
    let samples = |edit: &Edit| matches!(edit.validate(), Err(InvalidEdit::Samples { .. }));
    let mut edit = good.clone();
    if let Change::Crater { bowl, .. } = &mut edit.change {
        *bowl = 0;
    }
    assert!(numbers(&edit));
    for by in [65_536, -65_536, i32::MIN] {
        assert!(numbers(&with(Change::Raise {
            by,
            hardness: 0,
            density: 0,
            may_clamp: false
        })));
    }
    for (least, most) in [(1, 5), (-1, -1), (-65_536, 0), (0, 65_536), (i32::MIN, 0)] {
        let (to, strength, hardness) = (0, 0, 0);
        assert!(numbers(&with(Change::Flatten {
            to,
            strength,
            hardness,
            least,
            most
        })));
    }
    let grid = |size: [u16; 2], spacing_log2, count: usize| {
        with(Change::Smooth {
            ground: CapturedGround {
                first: [0; 2],
                spacing_log2,
                size,
                heights: vec![0; count].into(),
            },
            strength: 0,
            hardness: 0,
            least: 0,
            most: 0,
        })
    };
    assert_eq!(grid([3, 2], 12, 6).validate(), Ok(()));
    assert!(numbers(&grid([3, 2], 13, 6)));
    assert!(numbers(&grid([0, 2], 1, 0)));
    assert!(numbers(&grid([2048, 1024], 1, 0)));
    assert!(samples(&grid([3, 2], 1, 5)));
    let stamp = |side: u16, count: usize, turn, sample| {
        with(Change::Stamp {
            image: StampImage {
                side,
                samples: Arc::from(vec![sample; count]),
            },
            by: 3,
            turn,
            density: 0,
            scorch: 0,
            may_clamp: false,
        })
    };
    assert_eq!(stamp(2, 4, [16384, 0], 0).validate(), Ok(()));
    assert!(numbers(&stamp(1, 1, [16384, 0], 0)));
    assert!(numbers(&stamp(1025, 1025 * 1025, [16384, 0], 0)));
    assert!(numbers(&stamp(2, 4, [0, 0], 0)));
    assert!(numbers(&stamp(2, 4, [16384, 0], i16::MIN)));
    assert!(samples(&stamp(2, 5, [16384, 0], 0)));
}
