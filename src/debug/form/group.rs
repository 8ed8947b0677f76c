//! Groups of settings: a component or a resource each.

use super::widgets::name_widget;
use super::{Form, Literal};
use bevy::ecs::component::Mutable;
use bevy::prelude::*;
use bevy_egui::egui;

/// How a group's value lies in the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::debug) enum Presence {
    /// Always there.
    Required,
    /// Its default counts where it isn't there.
    Default,
    /// It does something where it is there; this switches it on.
    Switch(&'static str),
}

/// What a group of settings is called and how it is shown.
pub(in crate::debug) struct Group<T> {
    /// What stands over it.
    pub title: &'static str,
    /// The type in Rust.
    pub type_name: &'static str,
    /// What its code imports, from this crate.
    pub imports: &'static str,
    pub presence: Presence,
    pub is_open: bool,
    /// What is wrong with a value.
    pub check: fn(&T) -> Option<String>,
    /// Goes through the fields of a value; the last parameter is the default.
    pub list: fn(&mut Form, &mut T, &T),
}

/// What is to become of a group's value.
enum Change<T> {
    None,
    Set(T),
    Remove,
}

/// Why a change was refused, and the value that stayed.
#[derive(Clone)]
struct Refused<T> {
    reason: String,
    value: T,
}

impl<T: Clone + PartialEq + Default + Send + Sync + 'static> Group<T> {
    /// Shows a value, which is an option where the world may hold none.
    fn show(
        &self,
        ui: &mut egui::Ui,
        owner: Option<Entity>,
        value: Option<&T>,
        default: &T,
    ) -> Change<T> {
        let differs = match self.presence {
            Presence::Switch(_) => value.is_some(),
            _ => value.is_some_and(|value| value != default),
        };
        let text = egui::RichText::new(self.title);
        let text = if differs {
            text.color(ui.visuals().warn_fg_color)
        } else {
            text.strong()
        };
        egui::CollapsingHeader::new(text)
            .id_salt(self.title)
            .default_open(self.is_open)
            .show(ui, |ui| self.body(ui, owner, value, default))
            .body_returned
            .unwrap_or(Change::None)
    }

    fn body(
        &self,
        ui: &mut egui::Ui,
        owner: Option<Entity>,
        value: Option<&T>,
        default: &T,
    ) -> Change<T> {
        let mut change = Change::None;
        let memory = ui.id().with((owner, "refused"));
        let forget = |ui: &mut egui::Ui| ui.data_mut(|data| data.remove::<Refused<T>>(memory));
        ui.horizontal(|ui| {
            if let Presence::Switch(label) = self.presence {
                let mut is_on = value.is_some();
                if ui.checkbox(&mut is_on, label).changed() {
                    forget(ui);
                    change = if is_on {
                        Change::Set(default.clone())
                    } else {
                        Change::Remove
                    };
                }
                if value.is_none() {
                    return;
                }
            }
            let current = value.unwrap_or(default);
            let reset = ui.add_enabled(current != default, egui::Button::new("Reset all").small());
            name_widget(&reset, "reset all of ", self.title);
            if reset.clicked() {
                forget(ui);
                change = Change::Set(default.clone());
            }
            let copy = ui.add(egui::Button::new("Copy as Rust").small());
            name_widget(&copy, "copy as Rust: ", self.title);
            if copy.clicked() {
                ui.copy_text(self.code(current));
            }
        });
        if value.is_none() && matches!(self.presence, Presence::Switch(_)) {
            forget(ui);
            return change;
        }
        let current = value.unwrap_or(default);
        let problem = (self.check)(current);
        if let Some(problem) = &problem {
            ui.colored_label(ui.visuals().error_fg_color, problem);
        }
        let mut edited = current.clone();
        let mut form = Form::show(ui);
        (self.list)(&mut form, &mut edited, default);
        if form.is_changed() {
            let refused = (self.check)(&edited);
            if problem.is_none()
                && let Some(reason) = refused
            {
                let value = current.clone();
                ui.data_mut(|data| data.insert_temp(memory, Refused { reason, value }));
            } else {
                forget(ui);
                change = Change::Set(edited);
            }
        }
        if let Some(refused) = ui.data(|data| data.get_temp::<Refused<T>>(memory)) {
            if refused.value == *current {
                ui.colored_label(ui.visuals().warn_fg_color, refused.reason);
            } else {
                // Somebody has changed the value since.
                forget(ui);
            }
        }
        change
    }

    /// The expression that makes a value, after a comment that says what it imports.
    pub(in crate::debug) fn code(&self, value: &T) -> String {
        format!(
            "// use bevy::prelude::*;\n// use bevy_tessera::{};\n{}",
            self.imports,
            self.literal(value).of(self.type_name)
        )
    }

    /// The fields in which a value differs from its type's default.
    pub(in crate::debug) fn literal(&self, value: &T) -> Literal {
        let mut value = value.clone();
        Form::write(|form| (self.list)(form, &mut value, &T::default()))
    }
}

/// Shows a component of an entity, and changes it where a control was used.
pub(in crate::debug) fn component<T>(
    ui: &mut egui::Ui,
    world: &mut World,
    entity: Entity,
    group: &Group<T>,
) where
    T: Component<Mutability = Mutable> + Clone + PartialEq + Default,
{
    let value = world.get::<T>(entity);
    if value.is_none() && group.presence == Presence::Required {
        return;
    }
    match group.show(ui, Some(entity), value, &T::default()) {
        Change::None => {}
        Change::Set(new) => match world.get_mut::<T>(entity) {
            Some(mut value) => *value = new,
            None => {
                if let Ok(mut entity) = world.get_entity_mut(entity) {
                    entity.insert(new);
                }
            }
        },
        Change::Remove => {
            if let Ok(mut entity) = world.get_entity_mut(entity) {
                entity.remove::<T>();
            }
        }
    }
}

/// Shows a resource where there is one, and changes it where a control was used.
pub(in crate::debug) fn resource<T>(ui: &mut egui::Ui, world: &mut World, group: &Group<T>)
where
    T: Resource<Mutability = Mutable> + Clone + PartialEq + Default,
{
    let Some(value) = world.get_resource::<T>() else {
        return;
    };
    if let Change::Set(new) = group.show(ui, None, Some(value), &T::default())
        && let Some(mut value) = world.get_resource_mut::<T>()
    {
        *value = new;
    }
}

/// Shows a value that lies somewhere else; returns another one where a control was used.
pub(in crate::debug) fn value<T>(ui: &mut egui::Ui, value: &T, group: &Group<T>) -> Option<T>
where
    T: Clone + PartialEq + Default + Send + Sync + 'static,
{
    match group.show(ui, None, Some(value), &T::default()) {
        Change::Set(new) => Some(new),
        Change::None | Change::Remove => None,
    }
}
