//! Packed tiles are what was packed, bit for bit, and nothing else can be unpacked.

use bevy_tessera::tile::{
    DensityTile, ErrorTile, HeightTile, PackError, TerrainTile, TileAddress, TileFormatError,
};
use proptest::prelude::*;

const ADDRESS: TileAddress = TileAddress::new(2, 5, 7);

/// A tile of three functions of a sample's, a texel's and a bound's number.
fn tile(
    height: impl Fn(usize) -> u16,
    density: impl Fn(usize) -> u8,
    error: impl Fn(usize, usize) -> u8,
) -> TerrainTile {
    let errors = (0..32 * 32).map(|at| std::array::from_fn(|k| error(at, k)));
    TerrainTile {
        heights: HeightTile::from_samples((0..133 * 133).map(height).collect()).expect("a tile"),
        densities: DensityTile::from_samples((0..35 * 35).map(density).collect()).expect("a tile"),
        errors: ErrorTile::from_texels(errors.collect()).expect("a tile"),
        stamp: 0x1234_5678,
    }
}

fn hash(at: usize, seed: u32) -> u32 {
    let mut value = (at as u32).wrapping_mul(0x9e37_79b9) ^ seed;
    value ^= value >> 15;
    value = value.wrapping_mul(0x85eb_ca6b);
    value ^ (value >> 13)
}

fn hills() -> TerrainTile {
    let height = |at: usize| {
        let (x, z) = ((at % 133) as f32, (at / 133) as f32);
        (30_000.0 + 4000.0 * (x * 0.05).sin() + 3000.0 * (z * 0.031 + x * 0.01).cos()) as u16
    };
    tile(
        height,
        |at| (at / 7) as u8,
        |at, k| if k < 7 { (at / 90 + 3 * k) as u8 } else { 0 },
    )
}

fn noise(seed: u32) -> TerrainTile {
    tile(
        |at| hash(at, seed) as u16,
        |at| hash(at, !seed) as u8,
        |at, k| hash(at * 8 + k, seed ^ 77) as u8,
    )
}

#[test]
fn tiles_are_unpacked_as_they_were_packed() {
    let extremes = tile(
        |at| if hash(at, 1) & 1 == 0 { 0 } else { u16::MAX },
        |at| if hash(at, 2) & 1 == 0 { 0 } else { u8::MAX },
        |at, k| {
            if hash(at * 8 + k, 3) & 1 == 0 {
                0
            } else {
                u8::MAX
            }
        },
    );
    let flat = tile(|_| 700, |_| 0, |_, _| 0);
    let stairs = tile(
        |at| (at / 133 * 400) as u16,
        |_| 255,
        |_, k| u8::from(k == 3),
    );
    for tile in [hills(), noise(1), noise(2), extremes, flat.clone(), stairs] {
        let packed = tile.pack();
        assert_eq!(TerrainTile::unpack(&packed), Ok(tile.clone()));
        // Whoever reads tiles reads both.
        assert_eq!(TerrainTile::decode(&packed, ADDRESS), Ok(tile.clone()));
        assert_eq!(packed, tile.pack(), "the same tile makes the same bytes");
    }
    let raw = hills().encode(ADDRESS).len();
    assert!(hills().pack().len() * 4 < raw);
    assert!(flat.pack().len() < 200, "{}", flat.pack().len());
    // What can't be packed takes hardly more.
    assert!(noise(3).pack().len() < raw + 1000);
}

#[test]
fn no_bit_of_a_pack_can_change_without_notice() {
    let packed = hills().pack();
    for at in 0..packed.len() {
        let mut bytes = packed.clone();
        bytes[at] ^= 1 << (at % 8);
        assert!(TerrainTile::unpack(&bytes).is_err(), "byte {at}");
    }
    for length in 0..packed.len() {
        assert!(TerrainTile::unpack(&packed[..length]).is_err(), "{length}");
    }
    let longer = [&packed[..], &[0]].concat();
    assert!(matches!(
        TerrainTile::unpack(&longer),
        Err(PackError::Length { .. })
    ));
    let mut newer = packed;
    newer[8] = 2;
    let error = TerrainTile::decode(&newer, ADDRESS).expect_err("another version");
    let wanted = PackError::Version {
        found: 2,
        wanted: 1,
    };
    assert_eq!(error, TileFormatError::Packed(wanted));
    assert!(
        error.to_string().contains("pack the terrain again"),
        "{error}"
    );
}

/// The bytes with their checksum put right, so that what is behind it is looked at.
fn forged(mut bytes: Vec<u8>) -> Vec<u8> {
    if bytes.len() >= 32 {
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(&bytes[..28]);
        hasher.update(&bytes[32..]);
        bytes[28..32].copy_from_slice(&hasher.finalize().to_le_bytes());
    }
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn forged_packs_are_tiles_or_errors_and_never_panics(
        changes in prop::collection::vec((0.0..1.0_f64, any::<u8>()), 1..12),
        near_start in any::<bool>(),
        rough in any::<bool>(),
    ) {
        let mut bytes = if rough { noise(9).pack() } else { hills().pack() };
        for (place, value) in changes {
            let room = if near_start { 200 } else { bytes.len() - 32 };
            bytes[32 + (place * room as f64) as usize] = value;
        }
        let _ = TerrainTile::unpack(&forged(bytes));
    }

    #[test]
    fn sections_of_any_bytes_are_tiles_or_errors(
        sections in prop::array::uniform3(prop::collection::vec(any::<u8>(), 0..300)),
    ) {
        let mut bytes = b"TSRPACK\0\x01\0\0\0\0\0\0\0".to_vec();
        for section in &sections {
            bytes.extend((section.len() as u32).to_le_bytes());
        }
        bytes.extend([0; 4]);
        bytes.extend(sections.concat());
        prop_assert!(TerrainTile::unpack(&forged(bytes)).is_err());
    }

    #[test]
    fn lengths_that_lie_are_refused(lengths in prop::array::uniform3(any::<u32>())) {
        let mut bytes = hills().pack();
        for (at, length) in lengths.iter().enumerate() {
            bytes[16 + 4 * at..20 + 4 * at].copy_from_slice(&length.to_le_bytes());
        }
        let refused = TerrainTile::unpack(&forged(bytes));
        let length = matches!(refused, Err(PackError::Length { .. }));
        prop_assert!(length);
    }
}
