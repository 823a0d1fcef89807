"""The quantiser steps and levels that one scene asks for, from small trial encodes."""
