//! What triggers do.

use super::command::{EditCommand, EditRefusal, Placed};
use super::{
    Crater, Edit, EditLog, Flatten, MergeEdits, Raise, RedoEdit, SampleRect, Smooth, Stamp,
    TerrainEditRedone, TerrainEditRefused, TerrainEditUndone, TerrainEdited, TerrainEdits,
    UndoEdit,
};
use crate::stream::{TerrainRegion, TerrainState};
use crate::terrain::Terrain;
use bevy::ecs::entity::EntityHashMap;
use bevy::ecs::system::SystemParam;
use bevy::log::warn;
use bevy::prelude::*;
use std::sync::Arc;

/// Lets terrains be edited. Part of [`TerrainPlugin`](crate::terrain::TerrainPlugin).
///
/// Edits happen when they are triggered: when the observers return, heights that are resident have
/// changed and queries answer with them.
pub(crate) struct EditPlugin;

impl Plugin for EditPlugin {
    fn build(&self, app: &mut App) {
        app.add_observer(edit::<Crater>)
            .add_observer(edit::<Raise>)
            .add_observer(edit::<Flatten>)
            .add_observer(edit::<Smooth>)
            .add_observer(edit::<Stamp>)
            .add_observer(keep_edits)
            .register_type::<Crater>()
            .register_type::<Raise>()
            .register_type::<Flatten>()
            .register_type::<Smooth>()
            .register_type::<SampleRect>()
            .add_observer(undo)
            .add_observer(redo)
            .add_observer(merge);
    }
}

/// New edits of a merge that are applied one by one; more are replayed together.
const MERGED_ONE_BY_ONE: usize = 64;

/// Gives logs to terrains that have none yet, and says where one is another terrain's.
pub(crate) fn start_logs(
    mut terrains: Query<(Entity, &TerrainState, &mut TerrainEdits)>,
    mut told: Local<EntityHashMap<[u64; 2]>>,
    mut commands: Commands,
) {
    told.retain(|terrain, _| terrains.contains(*terrain));
    for (entity, state, mut edits) in &mut terrains {
        let file = &state.manifest().file;
        let error = match edits.log() {
            None => None,
            Some(log) => match log.check_terrain(file) {
                Ok(()) => continue,
                // Nothing is lost with an empty one.
                Err(_) if log.is_empty() => None,
                Err(error) => Some(error),
            },
        };
        let Some(error) = error else {
            edits.set_log(EditLog::new(file));
            continue;
        };
        let which = [state.instance(), edits.instance()];
        if told.insert(entity, which) != Some(which) {
            let reason = format!("terrain {entity} is shown without its edits: {error}");
            warn!("{reason}");
            let terrain = Some(entity);
            commands.trigger(TerrainEditRefused { terrain, reason });
        }
    }
}

/// A terrain always has a log: what removes it removes all edits.
fn keep_edits(removed: On<Remove, TerrainEdits>, mut commands: Commands) {
    let terrain = removed.entity;
    commands.queue(move |world: &mut World| {
        if let Ok(mut terrain) = world.get_entity_mut(terrain)
            && terrain.contains::<Terrain>()
            && !terrain.contains::<TerrainEdits>()
        {
            terrain.insert(TerrainEdits::default());
        }
    });
}

/// All terrains that can be edited.
#[derive(SystemParam)]
struct Editable<'w, 's> {
    terrains: Query<
        'w,
        's,
        (
            Entity,
            &'static mut TerrainState,
            &'static mut TerrainEdits,
            &'static GlobalTransform,
        ),
    >,
    commands: Commands<'w, 's>,
}

fn edit<E: EditCommand>(command: On<E>, mut editable: Editable) {
    let (at, terrain) = command.event().place();
    let terrain = terrain.or_else(|| editable.nearest(at));
    if let Err(refusal) = editable.make(terrain, command.event()) {
        editable.refuse(terrain, &refusal);
    }
}

fn undo(command: On<UndoEdit>, mut editable: Editable) {
    let terrain = command.terrain.or_else(|| editable.only());
    if let Err(refusal) = editable.turn(terrain, command.sequence, Turn::Undo) {
        editable.refuse(terrain, &refusal);
    }
}

fn redo(command: On<RedoEdit>, mut editable: Editable) {
    let terrain = command.terrain.or_else(|| editable.only());
    if let Err(refusal) = editable.turn(terrain, command.sequence, Turn::Redo) {
        editable.refuse(terrain, &refusal);
    }
}

fn merge(command: On<MergeEdits>, mut editable: Editable) {
    let terrain = command.terrain.or_else(|| editable.only());
    if let Err(refusal) = editable.merge(terrain, command.event()) {
        editable.refuse(terrain, &refusal);
    }
}

impl Editable<'_, '_> {
    fn refuse(&mut self, terrain: Option<Entity>, refusal: &EditRefusal) {
        let reason = refusal.to_string();
        warn!("{reason}");
        self.commands
            .trigger(TerrainEditRefused { terrain, reason });
    }

    /// The only terrain there is.
    fn only(&self) -> Option<Entity> {
        let mut terrains = self.terrains.iter();
        let (first, ..) = terrains.next()?;
        terrains.next().is_none().then_some(first)
    }

    /// The terrain whose ground is nearest to a place; one that the place isn't over counts from its
    /// edge.
    fn nearest(&self, at: Vec3) -> Option<Entity> {
        let distances = self
            .terrains
            .iter()
            .filter_map(|(entity, state, _, transform)| {
                let affine = transform.affine();
                let local = affine.inverse().transform_point3(at);
                let file = &state.manifest().file;
                let last = file
                    .size
                    .map(|samples| f64::from(samples - 1) * file.spacing_m);
                let inside = local
                    .xz()
                    .as_dvec2()
                    .clamp(bevy::math::DVec2::ZERO, last.into());
                let height_m = state.height(inside).map_or(0.0, |height| height.height_m);
                let inside = inside.as_vec2();
                let ground = Vec3::new(inside.x, height_m as f32, inside.y);
                let distance = affine.transform_point3(ground).distance_squared(at);
                distance.is_finite().then_some((distance, entity))
            });
        let nearest = distances.min_by(|(a, _), (b, _)| a.total_cmp(b));
        nearest.map(|(_, entity)| entity).or_else(|| self.only())
    }

    fn make<E: EditCommand>(
        &mut self,
        terrain: Option<Entity>,
        command: &E,
    ) -> Result<(), EditRefusal> {
        let edit = E::NAME;
        let found = terrain.and_then(|terrain| self.terrains.get_mut(terrain).ok());
        let Some((entity, mut state, mut edits, transform)) = found else {
            return Err(EditRefusal::NoTerrain { edit });
        };
        if !state.is_ready() {
            return Err(EditRefusal::NoTerrain { edit });
        }
        let placed = Placed::new(edit, &state, transform, command.place().0)?;
        let made = command.resolve(&placed)?;
        let invalid = |reason| EditRefusal::Invalid { edit, reason };
        let log = edits.log_mut().ok_or(EditRefusal::NoTerrain { edit })?;
        log.check_terrain(&state.manifest().file)
            .map_err(|error| invalid(error.to_string()))?;
        state.catch_up(entity, log, &mut self.commands);
        let sequence = log
            .push(made.clone())
            .map_err(|error| invalid(error.to_string()))?;
        let clamped = state.apply_edit(sequence, &made, log, &mut self.commands);
        self.commands
            .trigger(edited(entity, &state, sequence, &made, clamped));
        Ok(())
    }

    fn history(
        &mut self,
        terrain: Option<Entity>,
    ) -> Result<
        (
            Entity,
            Mut<'_, TerrainState>,
            Mut<'_, TerrainEdits>,
            Commands<'_, '_>,
        ),
        EditRefusal,
    > {
        let found = terrain.and_then(|terrain| self.terrains.get_mut(terrain).ok());
        let Some((entity, state, edits, _)) =
            found.filter(|(_, _, edits, _)| edits.log().is_some())
        else {
            return Err(EditRefusal::History(
                "no terrain is named and ready whose edits could be changed: name one that has \
                 loaded"
                    .to_owned(),
            ));
        };
        if let Some(log) = edits.log() {
            log.check_terrain(&state.manifest().file)
                .map_err(|error| EditRefusal::History(error.to_string()))?;
        }
        Ok((entity, state, edits, self.commands.reborrow()))
    }

    /// Takes an edit back, or makes it again.
    fn turn(
        &mut self,
        terrain: Option<Entity>,
        sequence: Option<u64>,
        turn: Turn,
    ) -> Result<(), EditRefusal> {
        let (entity, mut state, mut edits, mut commands) = self.history(terrain)?;
        let Some(log) = edits.log_mut() else {
            return Ok(());
        };
        state.catch_up(entity, log, &mut commands);
        let sequence = match (sequence, turn) {
            (Some(sequence), Turn::Undo) => log.undo(sequence).map(|_| sequence),
            (Some(sequence), Turn::Redo) => log.redo(sequence).map(|_| sequence),
            (None, Turn::Undo) => Ok(log.undo_last().ok_or_else(|| nothing_left("undone"))?),
            (None, Turn::Redo) => Ok(log.redo_last().ok_or_else(|| nothing_left("redone"))?),
        };
        let sequence = sequence.map_err(|error| EditRefusal::History(error.to_string()))?;
        let Some(edit) = log.edit(sequence).cloned() else {
            return Ok(());
        };
        state.replay_around(&[Arc::clone(&edit)], log, &mut commands);
        turn.tell(entity, &state, sequence, &edit, &mut commands);
        Ok(())
    }

    fn merge(&mut self, terrain: Option<Entity>, command: &MergeEdits) -> Result<(), EditRefusal> {
        let (entity, mut state, mut edits, mut commands) = self.history(terrain)?;
        let Some(log) = edits.log_mut() else {
            return Ok(());
        };
        state.catch_up(entity, log, &mut commands);
        let merged = log
            .merge(command.diff.clone())
            .map_err(|error| EditRefusal::History(error.to_string()))?;
        let changed = |sequences: &[u64]| -> Vec<_> {
            let edits = sequences.iter();
            edits
                .filter_map(|&sequence| Some((sequence, log.edit(sequence)?.clone())))
                .collect()
        };
        let applied = changed(&merged.applied);
        let undone = changed(&merged.undone);
        let redone = changed(&merged.redone);
        let mut clamped = vec![false; applied.len()];
        if undone.is_empty() && redone.is_empty() && applied.len() <= MERGED_ONE_BY_ONE {
            for ((sequence, edit), clamped) in applied.iter().zip(&mut clamped) {
                *clamped = state.apply_edit(*sequence, edit, log, &mut commands);
            }
        } else {
            let all = applied.iter().chain(&undone).chain(&redone);
            let edits: Vec<_> = all.map(|(_, edit)| Arc::clone(edit)).collect();
            state.replay_around(&edits, log, &mut commands);
        }
        // Edits may have come that were undone in the same breath.
        state.note_log(log);
        for (turn, edits) in [(Turn::Undo, undone), (Turn::Redo, redone)] {
            for (sequence, edit) in edits {
                turn.tell(entity, &state, sequence, &edit, &mut commands);
            }
        }
        for ((sequence, edit), clamped) in applied.into_iter().zip(clamped) {
            commands.trigger(edited(entity, &state, sequence, &edit, clamped));
        }
        Ok(())
    }
}

/// A way through the log.
#[derive(Clone, Copy)]
enum Turn {
    Undo,
    Redo,
}

impl Turn {
    /// Tells the game of an edit that has been taken back, or is there again.
    fn tell(
        self,
        entity: Entity,
        state: &TerrainState,
        sequence: u64,
        edit: &Edit,
        commands: &mut Commands,
    ) {
        let rect = edit.rect();
        let region = region_of(state, rect);
        match self {
            Self::Undo => commands.trigger(TerrainEditUndone {
                entity,
                sequence,
                rect,
                region,
            }),
            Self::Redo => commands.trigger(TerrainEditRedone {
                entity,
                sequence,
                rect,
                region,
            }),
        }
    }
}

fn nothing_left(done: &str) -> EditRefusal {
    EditRefusal::History(format!("there is no edit left that could be {done}"))
}

fn edited(
    entity: Entity,
    state: &TerrainState,
    sequence: u64,
    edit: &Edit,
    clamped: bool,
) -> TerrainEdited {
    let rect = edit.rect();
    TerrainEdited {
        entity,
        sequence,
        rect,
        region: region_of(state, rect),
        clamped,
    }
}

/// A rectangle of samples in metres of the terrain's own x and z.
fn region_of(state: &TerrainState, rect: SampleRect) -> TerrainRegion {
    let spacing_m = state.manifest().file.spacing_m;
    let metres = |at: [i32; 2], less: i32| {
        let [x, z] = at.map(|at| (f64::from(at - less) * spacing_m) as f32);
        Vec2::new(x, z)
    };
    TerrainRegion {
        min_m: metres(rect.min, 0),
        max_m: metres(rect.max, 1),
    }
}
