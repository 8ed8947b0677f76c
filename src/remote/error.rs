//! Why a remote request can't be met.

use bevy::prelude::Entity;
use bevy::remote::{BrpError, error_codes};
use thiserror::Error;

/// Why `terrain.stats` or `terrain.set` can't do what it was asked; each is a sentence that names the
/// thing, the cause and the remedy, and goes to the client as the error's `message`.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TerrainRemoteError {
    /// The parameters can't be read.
    #[error("the parameters of `{method}` can't be read: {cause}; give {wanted}")]
    Parameters {
        /// The method.
        method: &'static str,
        /// What is wrong with them.
        cause: String,
        /// What they should be.
        wanted: &'static str,
    },
    /// There is no such component or resource, or it is none of a terrain's.
    #[error("`{name}` holds no settings of terrains: use one of {known}")]
    UnknownComponent {
        /// What was asked for.
        name: String,
        /// All that there are.
        known: String,
    },
    /// An entity was named for what belongs to none.
    #[error("`{component}` is for all terrains and cameras: leave `entity` out")]
    NoEntityWanted {
        /// The resource.
        component: &'static str,
    },
    /// There is no such entity.
    #[error("there is no entity {entity}: take one from the answer of `terrain.stats`")]
    UnknownEntity {
        /// Its number.
        entity: u64,
    },
    /// The entity doesn't have the component, or none does.
    #[error("{who} has no `{component}`: {remedy}")]
    NotThere {
        /// Which entity, or that it is none.
        who: String,
        /// The component or resource.
        component: &'static str,
        /// What to do.
        remedy: String,
    },
    /// More than one entity has the component, and none was named.
    #[error("{count} entities have a `{component}`: name one of {entities} as `entity`")]
    Ambiguous {
        /// The component.
        component: &'static str,
        /// How many.
        count: usize,
        /// The first of them.
        entities: String,
    },
    /// The path leads nowhere.
    #[error("`{component}` has nothing at the path `{path}`: {cause}; use {known}")]
    UnknownPath {
        /// The component or resource.
        component: &'static str,
        /// The path.
        path: String,
        /// Where it ends.
        cause: String,
        /// What the component has.
        known: String,
    },
    /// What the path leads to isn't made of numbers, names and lists.
    #[error("{setting} can't be sent or set as JSON: change it in the game's code")]
    NotPlain {
        /// The setting.
        setting: String,
    },
    /// The value is of another type than the setting.
    #[error("{setting} can't be {value}: {cause}; give {wanted}")]
    WrongType {
        /// The setting.
        setting: String,
        /// The value, as far as it is short.
        value: String,
        /// What is wrong with it.
        cause: String,
        /// What it should be.
        wanted: String,
    },
    /// The setting can't be used, as itself or together with others.
    #[error("{0}")]
    Refused(String),
}

impl TerrainRemoteError {
    /// Every entity in a message reads as it has to be sent.
    pub(super) fn not_there(who: Option<Entity>, component: &'static str, remedy: String) -> Self {
        let who = who.map_or_else(
            || "the app".to_owned(),
            |entity| format!("entity {}", entity.to_bits()),
        );
        Self::NotThere {
            who,
            component,
            remedy,
        }
    }

    const fn code(&self) -> i16 {
        match self {
            Self::UnknownEntity { .. } => error_codes::ENTITY_NOT_FOUND,
            Self::NotThere { .. } => error_codes::COMPONENT_NOT_PRESENT,
            _ => error_codes::INVALID_PARAMS,
        }
    }
}

impl From<TerrainRemoteError> for BrpError {
    fn from(error: TerrainRemoteError) -> Self {
        Self {
            code: error.code(),
            message: error.to_string(),
            data: None,
        }
    }
}
